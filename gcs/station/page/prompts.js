/** The confirmations of a kill, and of taking a vehicle back from its pilot. */

import { byId, setText } from "./dom.js";
import { vehicleNames } from "./units.js";

/** Requires the verb's name, typed letter by letter: pasted, dropped, completed and repeated letters do not count. */
export class KillPrompt {
  /** @param {function(Object, Object, string)} send called with the verb, the target and the word */
  constructor(send) {
    this.dialog = byId("kill");
    this.input = byId("kill-word");
    this.button = byId("kill-send");
    this.typed = "";
    this.dialog.querySelector("form").addEventListener("submit", (event) => this.#submit(event, send));
    byId("kill-cancel").addEventListener("click", () => this.dialog.close());
    for (const way of ["paste", "drop"]) this.input.addEventListener(way, (event) => this.#refuse(event));
    this.input.addEventListener("keydown", (event) => event.repeat && event.preventDefault());
    this.input.addEventListener("input", () => this.#check());
  }

  /** @param {{vehicles: number[], all: number[]}} target */
  ask(verb, target) {
    this.verb = verb;
    this.target = target;
    this.#reset("");
    setText(byId("kill-title"), `Cut the motors of ${vehicleNames(target.vehicles, target.all)}`);
    this.dialog.showModal();
    this.input.focus();
  }

  #refuse(event) {
    event.preventDefault();
    this.#reset(`Type ${this.verb.name} letter by letter.`);
  }

  #check() {
    if (this.input.value.length > this.typed.length + 1) this.#reset(`Type ${this.verb.name} letter by letter.`);
    this.typed = this.input.value;
    this.button.disabled = this.typed !== this.verb.name;
  }

  #reset(message) {
    this.input.value = this.typed = "";
    this.button.disabled = true;
    setText(byId("kill-message"), message);
  }

  #submit(event, send) {
    event.preventDefault();
    if (this.typed !== this.verb.name) return;
    this.dialog.close();
    send(this.verb, this.target, this.typed);
    this.typed = "";
  }
}

/** Requires a decision whether vehicles are taken back from their pilots. */
export class PilotPrompt {
  /** @param {function(Object, Object, boolean)} send called with the verb, a target, and whether it overrides pilots */
  constructor(send) {
    this.dialog = byId("pilot");
    byId("pilot-leave").addEventListener("click", () => this.dialog.close());
    byId("pilot-others").addEventListener("click", () => this.#answer(send, this.others, false));
    byId("pilot-take").addEventListener("click", () => this.#answer(send, this.target, true));
  }

  /** @param {{vehicles: number[], all: number[]}} target @param {number[]} flown by their pilots */
  ask(verb, target, flown) {
    this.verb = verb;
    this.target = target;
    this.others = { ...target, isAll: false, vehicles: target.vehicles.filter((id) => !flown.includes(id)) };
    const are = flown.length === 1 ? "is flown by its pilot or autopilot" : "are flown by their pilots or autopilots";
    const names = vehicleNames(flown, target.all);
    setText(byId("pilot-title"), `${names[0].toUpperCase()}${names.slice(1)} ${are}`);
    setText(byId("pilot-take"), `Take over ${vehicleNames(target.vehicles, target.all)}`);
    setText(byId("pilot-others"), `Resume only ${vehicleNames(this.others.vehicles, target.all)}`);
    byId("pilot-others").hidden = this.others.vehicles.length === 0;
    this.dialog.showModal();
    byId("pilot-leave").focus();
  }

  #answer(send, target, overrides) {
    this.dialog.close();
    send(this.verb, target, overrides);
  }
}
