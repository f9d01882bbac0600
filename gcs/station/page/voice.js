/** Alarms spoken by the browser (Web Speech). Off until its button is pressed, at each start of the page. */

import { setText } from "./dom.js";

export class Voice {
  #isOn = false;

  /** @param {HTMLButtonElement} button hidden where the browser cannot speak */
  constructor(button) {
    this.button = button;
    button.hidden = !window.speechSynthesis;
    button.addEventListener("click", () => this.#turn(!this.#isOn));
    this.#show();
  }

  /** Say a text after what is being said, if the voice is on. */
  say(text) {
    if (!this.#isOn) return;
    const spoken = new SpeechSynthesisUtterance(text);
    spoken.lang = "en";
    speechSynthesis.speak(spoken);
  }

  #turn(isOn) {
    this.#isOn = isOn;
    if (isOn) this.say("Voice on");
    else speechSynthesis.cancel();
    this.#show();
  }

  #show() {
    this.button.setAttribute("aria-pressed", String(this.#isOn));
    setText(this.button, `Voice ${this.#isOn ? "on" : "off"}`);
  }
}
