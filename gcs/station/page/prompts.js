/** The dialogs before a command: the word of a kill, taking a vehicle back from its pilot, and the values of a ring. */

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

/** Asks for the values of a ring, within what the team can fly at the radius that is chosen. */
export class RingPrompt {
  /** @param {function(Object, Object, Array)} send called with the verb, the target, and [radius, rate], null to keep one */
  constructor(send) {
    this.dialog = byId("change-ring");
    this.radius = byId("ring-radius");
    this.rate = byId("ring-rate");
    this.dialog.querySelector("form").addEventListener("submit", (event) => this.#submit(event, send));
    byId("ring-cancel").addEventListener("click", () => this.dialog.close());
    for (const slider of [this.radius, this.rate]) slider.addEventListener("input", () => this.#move(slider));
  }

  /** @param {Object} bounds of a MissionPicture @param {number[]} ring the present radius and rate */
  ask(verb, target, bounds, ring) {
    this.verb = verb;
    this.target = target;
    this.bounds = bounds;
    [this.radius_m, this.rate_rad_s] = ring;
    this.moved = new Set();
    const step = Number(this.radius.step);
    this.radius.min = String((Math.floor(bounds.radius_min_m / step) + 1) * step);
    this.radius.max = String((Math.ceil(bounds.radius_max_m / step) - 1) * step);
    this.radius.value = String(this.radius_m);
    this.#show();
    this.rate.value = String(this.rate_rad_s);
    this.dialog.showModal();
  }

  #move(slider) {
    this.moved.add(slider);
    this.#show();
  }

  /** The ring that is asked for: a slider that was not moved has the present value, which lies between its steps. */
  get #wanted() {
    const radius_m = this.moved.has(this.radius) ? Number(this.radius.value) : this.radius_m;
    const { speed_max_m_s, acceleration_max_m_s2 } = this.bounds;
    const most_rad_s = Math.max(0, Math.min(speed_max_m_s / radius_m, Math.sqrt(acceleration_max_m_s2 / radius_m)));
    const isMoved = this.moved.has(this.rate) || Math.abs(this.rate_rad_s) > most_rad_s;
    return { radius_m, most_rad_s, isMoved, rate_rad_s: isMoved ? Number(this.rate.value) : this.rate_rad_s };
  }

  #show() {
    const step = Number(this.rate.step);
    const most = Math.floor(this.#wanted.most_rad_s / step + 1e-9) * step;
    this.rate.min = String(-most);
    this.rate.max = String(most);
    const { radius_m, rate_rad_s } = this.#wanted;
    setText(byId("ring-radius-text"), `${radius_m.toFixed(1)} m (${this.radius.min} to ${this.radius.max} m)`);
    setText(byId("ring-rate-text"), `${rate_rad_s.toFixed(3)} rad/s (up to ${most.toFixed(3)} either way)`);
    setText(byId("ring-message"), `${Math.abs(radius_m * rate_rad_s).toFixed(2)} m/s along the ring, ${direction(rate_rad_s)}`);
    byId("ring-send").disabled = this.#changes.every((value) => value === null);
  }

  get #changes() {
    const { radius_m, rate_rad_s, isMoved } = this.#wanted;
    return [this.moved.has(this.radius) ? radius_m : null, isMoved ? rate_rad_s : null];
  }

  #submit(event, send) {
    event.preventDefault();
    this.dialog.close();
    send(this.verb, this.target, this.#changes);
  }
}

function direction(rate_rad_s) {
  if (rate_rad_s === 0) return "at rest";
  const turn_s = (2 * Math.PI) / Math.abs(rate_rad_s);
  return `${rate_rad_s > 0 ? "counter-clockwise" : "clockwise"}, one turn in ${turn_s.toFixed(0)} s`;
}
