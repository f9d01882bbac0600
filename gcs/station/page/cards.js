/** Cards: one per vehicle, the gravest trouble first. */

import { cameraParts } from "./camera.js";
import { byId, element, SEVERITIES, setAttribute, setText } from "./dom.js";
import { actWhenHeld } from "./hold_button.js";
import { copyOnClick, placeText } from "./places.js";
import { age, clock, degrees, metres, nearest, percent, positioning, quantity, speed, UNKNOWN } from "./units.js";
import { byTrouble, due, headline, tactic, trouble } from "./vehicles.js";

const SIGNS = { ...SEVERITIES, stale: { sign: "◌", word: "STALE" }, ended: { sign: "□", word: "Ended" } };

const VEHICLES_LARGE = 8;
const BRIEF = ["battery", "height"]; // of a compact card
const COLOURS = 8;
const BORDERS = ["solid", "double", "dashed", "dotted"];

/** The quantities of a vehicle, as a card and the table show them: name, title, text. */
export const QUANTITIES = [
  ["mode", "Mode", (vehicle) => vehicle.mode || UNKNOWN],
  ["battery", "Battery", (vehicle) => percent(vehicle.autopilot.battery)],
  ["endurance", "Time left", (vehicle) => clock(vehicle.autopilot.endurance_s)],
  ["height", "Height", (vehicle) => metres(vehicle.position_m?.[2])],
  ["speed", "Speed", (vehicle) => speed(vehicle.velocity_m_s)],
  ["gps", "GPS", positioning],
  ["estimator", "Estimator", (vehicle) => vehicle.estimator || UNKNOWN],
  ["wind", "Wind", (vehicle) => quantity(vehicle.autopilot.wind_m_s, 1, "m/s")],
  ["link", "Link age", (vehicle) => age(vehicle.link_age_s)],
  ["heard", "Received", (vehicle) => (vehicle.age_s === null ? UNKNOWN : `${age(vehicle.age_s)} ago`)],
  ["nearest", "Nearest", nearest],
  ["margin", "Margin", (vehicle, mission) => metres(separationMargin(vehicle, mission))],
  ["fence", "To fence", (vehicle) => metres(vehicle.fence_margin_m)],
  ["radius", "Radius", (vehicle) => metres(vehicle.radius_m)],
  ["rate", "Ring rate", (vehicle) => quantity(vehicle.angular_rate_rad_s, 3, "rad/s")],
  ["lead", "Lead", (vehicle) => degrees(vehicle.lead_rad)],
  ["place", "Position", (vehicle, mission) => placeText(mission, vehicle.position_m)],
  ["home", "Home", (vehicle, mission) => placeText(mission, planned(mission, vehicle).start_m)],
];

/** The quantities that a click copies. */
export const COPIED = ["place", "home"];

const COPIES = { type: "button", class: "copies", title: "Copy" };

const planned = (mission, vehicle) => mission.vehicles.find((each) => each.vehicle_id === vehicle.vehicle_id);

function separationMargin(vehicle, mission) {
  return vehicle.nearest_m === null ? null : vehicle.nearest_m - mission.separation_m;
}

export class Cards {
  /**
   * @param {HTMLElement} list @param {Selection} selection the vehicles that receive commands
   * @param {function(Object): boolean} send passes a confirmation to the station
   */
  constructor(list, selection, send) {
    this.list = list;
    this.selection = selection;
    this.send = send;
    this.cards = new Map();
    selection.changed(() => this.#showSelection());
    copyOnClick(list);
    byId("compact").addEventListener("click", () => this.#compact(!list.classList.contains("compact")));
  }

  /** Show the vehicles of a mission; those of a large team as a compact list. */
  start(mission) {
    this.mission = mission;
    this.#compact(mission.vehicles.length > VEHICLES_LARGE);
    this.cards = new Map(mission.vehicles.map((planned) => [planned.vehicle_id, this.#card(planned)]));
    this.list.replaceChildren(...[...this.cards.values()].map((card) => card.item));
    this.#showSelection();
  }

  /** Show the vehicles of a TeamPicture. */
  update(team) {
    for (const vehicle of team.vehicles) this.#fill(vehicle, team);
    if (!this.list.matches(":active")) this.#sort(byTrouble(team)); // no card moves while a finger presses one
  }

  #card(planned) {
    const id = planned.vehicle_id;
    const parts = {
      badge: element("span", { class: "badge" }),
      tactic: element("span", { class: "tactic" }),
      headline: element("p", { class: "headline" }),
      due: element("p", { class: "due", hidden: true }),
      advice: element("p", { class: "advice", hidden: true }),
      recovered: element("button", { type: "button", class: "held recovered", hidden: true }, "Recovered: hold 1 s"),
      select: element("input", { type: "checkbox", "aria-label": `Select vehicle ${id}` }),
    };
    parts.select.addEventListener("change", () => this.selection.set(id, parts.select.checked));
    const title = element("h3", { id: `card-${id}` }, vehicleMark(planned, this.mission.vehicles.indexOf(planned)), parts.tactic, parts.badge);
    const select = element("label", { class: "select" }, parts.select);
    const values = QUANTITIES.map(([name, label]) => {
      const isCopied = COPIED.includes(name);
      parts[name] = element(isCopied ? "button" : "dd", { "data-quantity": name, ...(isCopied ? COPIES : {}) });
      const value = isCopied ? element("dd", {}, parts[name]) : parts[name];
      return element("div", { class: isCopied ? "wide" : BRIEF.includes(name) && "brief" }, element("dt", {}, label), value);
    });
    actWhenHeld(parts.recovered, () => this.send({ kind: "recovered", vehicle_id: id }));
    const camera = planned.camera_url ? cameraParts(planned, this.mission) : [];
    const head = element("div", { class: "card-head" }, title, select);
    const item = element("li", { class: "card", "data-vehicle": id, "aria-labelledby": `card-${id}` });
    item.append(head, parts.headline, parts.due, parts.advice, parts.recovered, ...camera, element("dl", {}, ...values));
    return { item, parts };
  }

  #fill(vehicle, team) {
    const card = this.cards.get(vehicle.vehicle_id);
    if (!card) return;
    const { item, parts } = card;
    const state = trouble(vehicle, team);
    setAttribute(item, "data-trouble", state);
    setAttribute(item, "data-current", String(!vehicle.is_stale));
    setAttribute(item, "data-unaccounted", String(vehicle.is_unaccounted));
    setText(parts.tactic, tactic(vehicle));
    setText(parts.badge, state === "information" ? "" : `${SIGNS[state].sign} ${SIGNS[state].word}`);
    setText(parts.headline, headline(vehicle, team));
    setText(parts.due, due(vehicle));
    parts.due.hidden = state === "ended" || !parts.due.textContent;
    setText(parts.advice, vehicle.advice);
    parts.recovered.hidden = !vehicle.is_unaccounted || this.mission.source === "log";
    parts.advice.hidden = !vehicle.advice || state === "ended";
    for (const [name, , text] of QUANTITIES) setText(parts[name], text(vehicle, this.mission));
  }

  #sort(vehicles) {
    const wanted = vehicles.map((vehicle) => this.cards.get(vehicle.vehicle_id)?.item).filter(Boolean);
    if (wanted.every((item, index) => this.list.children[index] === item)) return;
    const focused = document.activeElement;
    this.list.append(...wanted);
    if (this.list.contains(focused)) focused.focus({ preventScroll: true });
  }

  #compact(isCompact) {
    this.list.classList.toggle("compact", isCompact);
    byId("compact").setAttribute("aria-pressed", String(isCompact));
  }

  #showSelection() {
    for (const [id, { item, parts }] of this.cards) {
      parts.select.checked = this.selection.has(id);
      parts.select.disabled = !this.selection.isOpen(id);
      item.classList.toggle("selected", this.selection.has(id));
    }
  }
}

/** The number of a vehicle on its colour; colours that repeat differ by the border. */
export function vehicleMark(planned, row) {
  const mark = element("span", { class: "mark" }, String(planned.vehicle_id));
  mark.style.setProperty("--vehicle", planned.colour);
  mark.style.borderStyle = BORDERS[Math.floor(row / COLOURS) % BORDERS.length];
  return mark;
}
