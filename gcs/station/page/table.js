/** All quantities of all vehicles in one table, also for browsers that cannot draw the map. */

import { element, setAttribute, setText } from "./dom.js";
import { COPIED, QUANTITIES } from "./cards.js";
import { copyOnClick } from "./places.js";
import { quantity } from "./units.js";
import { headline, tactic, trouble } from "./vehicles.js";

const coordinate = (index) => (vehicle) => quantity(vehicle.position_m?.[index], 1, "m");
const COLUMNS = [
  ["tactic", "Tactic", tactic],
  ["x", "x", coordinate(0)],
  ["y", "y", coordinate(1)],
  ...QUANTITIES,
  ["alert", "Alert", (vehicle, mission, team) => headline(vehicle, team)],
];

export class Table {
  /** @param {HTMLTableElement} table */
  constructor(table) {
    this.table = table;
    copyOnClick(table);
  }

  start(mission) {
    this.mission = mission;
    const titles = COLUMNS.map(([, title]) => element("th", { scope: "col" }, title));
    const head = element("thead", {}, element("tr", {}, element("th", { scope: "col" }, "Vehicle"), ...titles));
    this.rows = new Map(mission.vehicles.map(({ vehicle_id }) => [vehicle_id, row(vehicle_id)]));
    const body = element("tbody", {}, ...[...this.rows.values()].map(({ item }) => item));
    this.first = "";
    this.table.replaceChildren(element("caption", { class: "hidden" }, "Vehicles"), head, body);
  }

  update(team) {
    const first = team.vehicles.filter((vehicle) => vehicle.is_unaccounted).map((vehicle) => vehicle.vehicle_id);
    if (first.join() !== this.first) this.#sort(first);
    for (const vehicle of team.vehicles) {
      const found = this.rows.get(vehicle.vehicle_id);
      if (!found) continue;
      setAttribute(found.item, "data-trouble", trouble(vehicle, team));
      COLUMNS.forEach(([, , text], index) => setText(found.cells[index], text(vehicle, this.mission, team)));
    }
  }

  /** Show these vehicles first. */
  #sort(first) {
    this.first = first.join();
    const rows = [...this.rows].toSorted(([one], [other]) => first.includes(other) - first.includes(one));
    this.table.querySelector("tbody").append(...rows.map(([, { item }]) => item));
  }
}

function row(vehicle_id) {
  const cells = COLUMNS.map(([name]) => element("td", { "data-quantity": name, class: COPIED.includes(name) && "copies" }));
  const item = element("tr", { "data-vehicle": vehicle_id }, element("th", { scope: "row" }, String(vehicle_id)), ...cells);
  return { item, cells };
}
