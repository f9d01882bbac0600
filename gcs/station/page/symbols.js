/** The vehicles and the target on the map: an arrow or a cross with a label, hatched if it is not current. */

import { drawing, element, setAttribute, setText } from "./dom.js";
import { reach } from "./marks.js";
import { age, metres } from "./units.js";
import { lastSeen, RESERVE, trouble } from "./vehicles.js";

const ARROW = "M0,-15 L11,12 L0,6 L-11,12 Z";
const ROUND = "M-9,0 A9,9 0 1 0 9,0 A9,9 0 1 0 -9,0 Z";

/** The symbol of a planned vehicle. @param {function()} pressed */
export function vehicleSymbol(planned, pressed) {
  const id = planned.vehicle_id;
  const shape = drawing("path", { d: ARROW, fill: planned.colour, class: "shape" });
  const picture = drawing("svg", { viewBox: "-20 -20 40 40", "aria-hidden": "true" });
  const number = drawing("text", { class: "number", y: 5 });
  number.textContent = id;
  picture.append(hatching(`hatch-${id}`, planned.colour), shape, number);
  const label = element("span", { class: "label" });
  const root = element("button", { type: "button", class: "symbol", "data-vehicle": id, tabindex: "-1" }, picture, label);
  root.addEventListener("click", pressed);
  return { root, shape, picture, label, colour: planned.colour, id };
}

/** Show a vehicle's picture; `rotation_deg` is clockwise from the top of the screen, null if unknown. */
export function showVehicle(symbol, vehicle, team, rotation_deg) {
  const state = trouble(vehicle, team);
  const isCurrent = !vehicle.is_stale && state !== "ended";
  setAttribute(symbol.root, "data-trouble", state);
  setAttribute(symbol.root, "data-current", String(isCurrent));
  setAttribute(symbol.shape, "d", rotation_deg === null ? ROUND : ARROW);
  setAttribute(symbol.shape, "fill", isCurrent ? symbol.colour : `url(#hatch-${symbol.id})`);
  setAttribute(symbol.shape, "stroke", isCurrent ? null : symbol.colour);
  setAttribute(symbol.shape, "transform", `rotate(${(rotation_deg ?? 0).toFixed(0)})`);
  const words = vehicle.in_reserve ? RESERVE : state === "ended" ? "ended" : lastSeen(vehicle);
  const sign = state === "alarm" ? "■ " : "";
  setText(symbol.label, `${sign}${symbol.id} · ${words || metres(vehicle.position_m[2])}`);
}

/** The name of a ring. */
export function ringSymbol({ name, colour }) {
  const root = element("div", { class: "ring-name" }, name);
  root.style.borderColor = colour;
  return { root };
}

/** The name of a no-fly zone, with the heights between which it is closed. */
export function zoneSymbol({ name, floor_m, ceiling_m }) {
  const from = floor_m === null ? "" : ` from ${floor_m} m`;
  const to = ceiling_m === null ? "" : ` to ${ceiling_m} m`;
  return { root: element("div", { class: "zone-name" }, `✕ ${name}${from}${to}`) };
}

/** The label of an aircraft outside the team. */
export function trafficSymbol() {
  return { root: element("div", { class: "traffic-name" }) };
}

/** Show an aircraft's label, its height and how long ago it reported itself. */
export function showTraffic(symbol, { label, altitude_m, age_s }) {
  setText(symbol.root, `▲ ${label} · ${altitude_m === null ? "height unknown" : metres(altitude_m)} · ${age(age_s)} ago`);
}

/** The symbol of a target. */
export function targetSymbol(name) {
  const picture = drawing("svg", { viewBox: "-20 -20 40 40", "aria-hidden": "true" });
  picture.append(drawing("path", { d: "M-9,-9 L9,9 M-9,9 L9,-9", class: "target-cross" }));
  const label = element("span", { class: "label" });
  return { root: element("div", { class: "symbol target" }, picture, label), label, name };
}

const SIGHTING_AGE_MAX_S = 2;

export function showTarget(symbol, target) {
  const isLost = target.lost_speed_m_s !== null;
  const isOld = isLost || target.sighting_age_s > SIGHTING_AGE_MAX_S;
  setAttribute(symbol.root, "data-current", String(!isOld));
  const seen = isOld ? `, seen ${age(target.sighting_age_s)} ago` : "";
  setText(symbol.label, `${symbol.name}${seen}${isLost ? `, within ${metres(reach(target))}` : ""}`);
}

function hatching(id, colour) {
  const pattern = drawing("pattern", { id, width: 5, height: 5, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" });
  pattern.append(drawing("rect", { width: 5, height: 5, class: "hatch-ground" }), drawing("rect", { width: 2, height: 5, fill: colour }));
  return pattern;
}
