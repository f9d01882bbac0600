/** The dialogs before a command: the word of a kill, taking a vehicle back from its pilot, a ring's values, its vehicles. */

import { byId, element, setText } from "./dom.js";
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

const TILT_MAX_DEG = 60;
const RING_VALUES = ["radius", "rate", "altitude", "tilt"];

/** Asks for the values of a ring, within what the team can fly. */
export class RingPrompt {
  /** @param {function(Object, Object, Object)} send called with the verb, the target, and the values and number of a ring */
  constructor(send) {
    this.dialog = byId("change-ring");
    this.sliders = RING_VALUES.map((name) => byId(`ring-${name}`));
    this.dialog.querySelector("form").addEventListener("submit", (event) => this.#submit(event, send));
    byId("ring-cancel").addEventListener("click", () => this.dialog.close());
    for (const slider of this.sliders) slider.addEventListener("input", () => this.#move(slider));
    this.names = byId("ring-name");
    this.names.addEventListener("change", () => this.#choose(this.names.selectedIndex));
  }

  /**
   * @param {{name: string, bounds: Object, ring: Array}[]} rings those that there are: bounds of a MissionPicture, the
   *   present radius, rate, altitude (null if it follows the target's) and tilt
   */
  ask(verb, target, rings) {
    Object.assign(this, { verb, target, rings });
    byId("ring-name-row").hidden = rings.length === 1;
    this.names.replaceChildren(...rings.map(({ name }) => element("option", {}, name)));
    this.#choose(0);
    this.dialog.showModal();
  }

  #choose(number) {
    const { bounds, ring } = this.rings[number];
    this.number = number;
    this.bounds = bounds;
    this.present = ring;
    this.moved = new Set();
    const [radius, rate, altitude, tilt] = this.sliders;
    const step = Number(radius.step);
    radius.min = String((Math.floor(bounds.radius_min_m / step) + 1) * step);
    radius.max = String((Math.ceil(bounds.radius_max_m / step) - 1) * step);
    [altitude.min, altitude.max] = [bounds.altitude_min_m, bounds.altitude_max_m].map(String);
    byId("ring-altitude-label").hidden = altitude.hidden = ring[2] === null;
    [radius.value, altitude.value] = [ring[0], ring[2] ?? bounds.altitude_min_m].map(String);
    this.#update();
    [rate.value, tilt.value] = [ring[1], ring[3]].map(String);
    this.#update();
  }

  #move(slider) {
    this.moved.add(slider);
    this.#update();
  }

  /** The value that is asked for: a slider that was not moved has the present value, which lies between its steps. */
  #asked(index) {
    return this.moved.has(this.sliders[index]) ? Number(this.sliders[index].value) : this.present[index];
  }

  /** The same of a value that others bound: beyond its bounds the slider has moved with them. */
  #bounded(index, most) {
    const isMoved = this.moved.has(this.sliders[index]) || Math.abs(this.present[index]) > most;
    return isMoved ? Number(this.sliders[index].value) : this.present[index];
  }

  #mostRate(radius_m) {
    const { speed_max_m_s, acceleration_max_m_s2 } = this.bounds;
    return Math.max(0, Math.min(speed_max_m_s / radius_m, Math.sqrt(acceleration_max_m_s2 / radius_m)));
  }

  #mostTilt(radius_m, rate_rad_s, altitude_m) {
    const { altitude_min_m, altitude_max_m, climb_max_m_s } = this.bounds;
    const between_m = (altitude_max_m - altitude_min_m) / 2;
    const room_m = altitude_m === null ? between_m : Math.min(altitude_max_m - altitude_m, altitude_m - altitude_min_m);
    const rise_m = Math.min(room_m, rate_rad_s ? climb_max_m_s / Math.abs(rate_rad_s) : Infinity);
    return Math.min(TILT_MAX_DEG, (Math.atan2(Math.max(0, rise_m), radius_m) * 180) / Math.PI);
  }

  /** Bound rate and tilt by the values before them, and show the ring that is asked for. */
  #update() {
    const [radius, rate, altitude, tilt] = this.sliders;
    const radius_m = this.#asked(0);
    const altitude_m = this.#asked(2);
    const most_rad_s = bound(rate, this.#mostRate(radius_m));
    const rate_rad_s = this.#bounded(1, this.#mostRate(radius_m));
    const most_deg = bound(tilt, this.#mostTilt(radius_m, rate_rad_s, altitude_m));
    const tilt_deg = this.#bounded(3, this.#mostTilt(radius_m, rate_rad_s, altitude_m));
    this.values = [radius_m, rate_rad_s, altitude_m, tilt_deg];
    setText(byId("ring-radius-text"), `${radius_m.toFixed(1)} m (${radius.min} to ${radius.max} m)`);
    setText(byId("ring-rate-text"), `${rate_rad_s.toFixed(3)} rad/s (up to ${most_rad_s.toFixed(3)} either way)`);
    setText(byId("ring-altitude-text"), `${altitude_m?.toFixed(1)} m (${altitude.min} to ${altitude.max} m)`);
    setText(byId("ring-tilt-text"), `${tilt_deg.toFixed(0)}° (up to ${most_deg.toFixed(0)}° either way)`);
    setText(byId("ring-message"), `${Math.abs(radius_m * rate_rad_s).toFixed(2)} m/s along the ring, ${direction(rate_rad_s)}`);
    byId("ring-send").disabled = this.#changes.every((value) => value === null);
  }

  get #changes() {
    return this.values.map((value, index) => (value === this.present[index] ? null : value));
  }

  #submit(event, send) {
    event.preventDefault();
    this.dialog.close();
    const number = this.rings.length === 1 ? {} : { ring_number: this.number };
    send(this.verb, this.target, { ring: this.#changes, ...number });
  }
}

const AUTO = "auto";

/** Asks for the ring that vehicles go to. */
export class AssignPrompt {
  /** @param {function(Object, Object, Object)} send called with the verb, the target, and the number of a ring */
  constructor(send) {
    this.dialog = byId("assign-ring");
    this.names = byId("assign-name");
    this.dialog.querySelector("form").addEventListener("submit", (event) => this.#submit(event, send));
    byId("assign-cancel").addEventListener("click", () => this.dialog.close());
  }

  /** @param {{name: string}[]} rings those that there are @param {Object[]} vehicles of a TeamPicture */
  ask(verb, target, rings, vehicles) {
    Object.assign(this, { verb, target });
    const options = rings.map(({ name }, number) => element("option", { value: String(number) }, name));
    this.names.replaceChildren(...options, element("option", { value: AUTO }, "its own choice"));
    const flown = new Set(vehicles.filter(({ vehicle_id: id }) => target.vehicles.includes(id)).map(({ ring }) => ring));
    const [only] = flown.size === 1 ? flown : [];
    this.names.selectedIndex = Math.max(0, rings.findIndex(({ name }) => name === only));
    setText(byId("assign-title"), `Assign ${vehicleNames(target.vehicles, target.all)} to a ring`);
    this.dialog.showModal();
  }

  #submit(event, send) {
    event.preventDefault();
    this.dialog.close();
    send(this.verb, this.target, { ring_number: this.names.value === AUTO ? null : Number(this.names.value) });
  }
}

/** Bound a slider about 0 in its steps, and return its bound. */
function bound(slider, most) {
  const step = Number(slider.step);
  const inSteps = Math.floor(most / step + 1e-9) * step;
  [slider.min, slider.max] = [-inSteps, inSteps].map(String);
  return inSteps;
}

function direction(rate_rad_s) {
  if (rate_rad_s === 0) return "at rest";
  const turn_s = (2 * Math.PI) / Math.abs(rate_rad_s);
  return `${rate_rad_s > 0 ? "counter-clockwise" : "clockwise"}, one turn in ${turn_s.toFixed(0)} s`;
}
