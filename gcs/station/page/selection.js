/** The vehicles that receive commands: those selected, or all if none is. */

export class Selection {
  #all = [];
  #chosen = new Set();
  #listeners = [];

  /** Set the vehicles of a mission; the selection of vehicles that remain is kept. */
  start(vehicle_ids) {
    this.#all = vehicle_ids;
    this.#chosen = new Set(vehicle_ids.filter((id) => this.#chosen.has(id)));
    this.#notify();
  }

  set(vehicle_id, isSelected) {
    if (isSelected) this.#chosen.add(vehicle_id);
    else this.#chosen.delete(vehicle_id);
    this.#notify();
  }

  toggle(vehicle_id) {
    this.set(vehicle_id, !this.has(vehicle_id));
  }

  clear() {
    this.#chosen.clear();
    this.#notify();
  }

  has(vehicle_id) {
    return this.#chosen.has(vehicle_id);
  }

  get isEmpty() {
    return this.#chosen.size === 0;
  }

  get all() {
    return this.#all;
  }

  /** The ids of the vehicles that receive commands now. */
  get vehicles() {
    return this.isEmpty ? this.#all : this.#all.filter((id) => this.#chosen.has(id));
  }

  /** Call a function after every change. */
  changed(listener) {
    this.#listeners.push(listener);
  }

  #notify() {
    for (const listener of this.#listeners) listener();
  }
}
