/** The vehicles that receive commands: those selected, or all that fly if none is. */

const SELECTED_FOR_MS = 10_000; // as at the terminal
const SURPRISING_MS = 700;

/** A selection is for the next command, and ends after a while: a forgotten one must not narrow a command. */
export class Selection {
  #planned = [];
  #ended = new Set();
  #missing = 0;
  #reserves = 0;
  #chosen = new Set();
  #listeners = [];
  #timer = null;
  #ends_ms = 0;
  #expired_ms = -Infinity;

  /** Set the vehicles of a mission; the selection of vehicles that remain is kept. */
  start(vehicle_ids) {
    this.#planned = vehicle_ids;
    this.#ended.clear();
    this.#missing = this.#reserves = 0;
    this.#choose(vehicle_ids.filter((id) => this.#chosen.has(id)));
  }

  /** Take the vehicles of a TeamPicture whose flight has ended: they receive no commands, also if unaccounted for. */
  update(team) {
    const ended = team.vehicles.filter((each) => each.has_ended || each.ending);
    const missing = ended.filter((each) => each.is_unaccounted).length;
    const reserves = ended.filter((each) => each.in_reserve).length;
    const isSame = ended.length === this.#ended.size && ended.every((each) => this.#ended.has(each.vehicle_id));
    if (isSame && missing === this.#missing && reserves === this.#reserves) return;
    this.#ended = new Set(ended.map((each) => each.vehicle_id));
    this.#missing = missing;
    this.#reserves = reserves;
    this.#choose([...this.#chosen].filter((id) => !this.#ended.has(id)));
  }

  set(vehicle_id, isSelected) {
    const others = [...this.#chosen].filter((id) => id !== vehicle_id);
    this.#chosen = new Set(isSelected && !this.#ended.has(vehicle_id) ? [...others, vehicle_id] : others);
    this.keep();
    this.#notify();
  }

  toggle(vehicle_id) {
    this.set(vehicle_id, !this.has(vehicle_id));
  }

  clear() {
    this.#choose([]);
  }

  /** Let the selection last for the whole time from now on: a command is being given. */
  keep() {
    clearTimeout(this.#timer);
    if (this.isEmpty) return;
    this.#timer = setTimeout(() => this.#expire(), SELECTED_FOR_MS);
    this.#ends_ms = performance.now() + SELECTED_FOR_MS;
  }

  has(vehicle_id) {
    return this.#chosen.has(vehicle_id);
  }

  /** Whether a vehicle can receive commands. */
  isOpen(vehicle_id) {
    return !this.#ended.has(vehicle_id);
  }

  get isEmpty() {
    return this.#chosen.size === 0;
  }

  /** For how long the selection lasts, in seconds. */
  get rest_s() {
    return Math.max(0, this.#ends_ms - performance.now()) / 1000;
  }

  /** Whether a selection ended by itself so recently that a press may still have been meant for it. */
  get hasJustEnded() {
    return this.isEmpty && performance.now() - this.#expired_ms < SURPRISING_MS;
  }

  /** Why vehicles receive no commands, with their numbers; empty if all receive them. */
  get without() {
    const counts = { ended: this.#ended.size - this.#missing - this.#reserves, missing: this.#missing, "in reserve": this.#reserves };
    return Object.entries(counts).flatMap(([why, count]) => (count ? `${count} ${why}` : [])).join(", ");
  }

  /** The ids of the vehicles whose flight has ended. */
  get landed() {
    return this.#planned.filter((id) => this.#ended.has(id));
  }

  /** The ids of all vehicles that fly, or will. */
  get all() {
    return this.#planned.filter((id) => !this.#ended.has(id));
  }

  /** The ids of the vehicles that receive commands now. */
  get vehicles() {
    return this.isEmpty ? this.all : this.all.filter((id) => this.#chosen.has(id));
  }

  /** Call a function after every change. */
  changed(listener) {
    this.#listeners.push(listener);
  }

  #expire() {
    this.#expired_ms = performance.now();
    this.clear();
  }

  #choose(vehicle_ids) {
    this.#chosen = new Set(vehicle_ids);
    if (this.isEmpty) clearTimeout(this.#timer);
    this.#notify();
  }

  #notify() {
    for (const listener of this.#listeners) listener();
  }
}
