/** The dialog before something is sent that has a place of the map: a report of the target, a vehicle's goal, or where cameras look. */

import { byId, element, setText } from "./dom.js";

export class PlacePrompt {
  constructor() {
    this.dialog = byId("place");
    this.dialog.querySelector("form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.dialog.close();
      this.send(this.#answer);
    });
    byId("place-cancel").addEventListener("click", () => this.dialog.close());
  }

  /** Ask where the target is. @param {string} place as text @param {string[]} targets names, if there are several */
  askTarget(place, targets, send) {
    this.#ask("The target is here", place, "Report the target", send);
    byId("place-target-row").hidden = targets.length === 0;
    byId("place-target").replaceChildren(...targets.map((name, number) => element("option", { value: String(number) }, name)));
    byId("place-sigma-row").hidden = byId("place-lasting-row").hidden = false;
    byId("place-sigma").value = "2";
    byId("place-lasting").value = "0";
    this.dialog.showModal();
    byId("place-sigma").select();
  }

  /** Ask for a vehicle. @param {string} title of the dialog and its button @param {[number, string][]} vehicles ids and names @param {number} chosen */
  askVehicle(title, place, vehicles, chosen, send) {
    this.#ask(title, place, title, send);
    byId("place-vehicle-row").hidden = false;
    byId("place-vehicle").replaceChildren(...vehicles.map(([id, name]) => element("option", { value: String(id) }, name)));
    byId("place-vehicle").value = String(chosen);
    this.dialog.showModal();
    byId("place-vehicle").focus();
  }

  #ask(title, place, action, send) {
    this.send = send;
    setText(byId("place-title"), title);
    setText(byId("place-where"), place);
    setText(byId("place-send"), action);
    for (const row of ["target", "vehicle", "sigma", "lasting"]) byId(`place-${row}-row`).hidden = true;
  }

  get #answer() {
    const [sigma_m, lasting_s, vehicle] = ["sigma", "lasting", "vehicle"].map((name) => Number(byId(`place-${name}`).value));
    const target = byId("place-target-row").hidden ? null : Number(byId("place-target").value);
    return { sigma_m, lasting_s, vehicle, target };
  }
}
