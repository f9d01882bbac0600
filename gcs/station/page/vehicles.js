/** The state of a vehicle from its picture: whether it is current, its trouble, and the text about it. */

import { targetsOf } from "./rings.js";
import { age, UNKNOWN } from "./units.js";

/** Vehicles of a picture older than this, in seconds, are drawn as stale. */
export const PICTURE_AGE_MAX_S = 1;
const CHARGE_LOW = 0.35;
export const RESERVE = "reserve";
const RANKS = { alarm: 0, stale: 1, warning: 2, information: 3, ended: 4 };

/**
 * The team to draw when its picture arrived `since_s` ago: an old picture is stale.
 * @param {Object} team a TeamPicture
 */
export function agedTeam(team, since_s) {
  if (since_s <= PICTURE_AGE_MAX_S) return team;
  const targets = targetsOf(team).map((target) => target && { ...target, sighting_age_s: target.sighting_age_s + since_s });
  const aged = team.targets ? { targets } : { target: targets[0] };
  return { ...team, wall_s: team.wall_s + since_s, ...aged, vehicles: team.vehicles.map((vehicle) => agedVehicle(vehicle, since_s)) };
}

function agedVehicle(vehicle, since_s) {
  const age_s = vehicle.age_s === null ? null : vehicle.age_s + since_s;
  const link_age_s = vehicle.link_age_s === null ? null : vehicle.link_age_s + since_s;
  const next = vehicle.next && { ...vehicle.next, in_s: Math.max(vehicle.next.in_s - since_s, 0) };
  return { ...vehicle, age_s, link_age_s, next, is_stale: true };
}

/** "ended", "stale" or the severity of its alert: it determines the look and the order of a vehicle. */
export function trouble(vehicle, team) {
  if (vehicle.is_unaccounted) return "alarm";
  if (vehicle.has_ended || team.ending) return "ended";
  if (vehicle.severity === "alarm") return "alarm";
  if (vehicle.is_stale) return "stale";
  return warning(vehicle) ? "warning" : vehicle.severity;
}

/** A vehicle's alert, or else a warning from its quantities; empty for none. */
export const alert = (vehicle) => vehicle.alert || warning(vehicle);

function warning(vehicle) {
  if (vehicle.fence_margin_m !== null && vehicle.fence_margin_m < 0) return "outside the fence";
  const { battery } = vehicle.autopilot;
  return battery !== null && battery < CHARGE_LOW ? "battery low" : "";
}

/** What a vehicle does next, what refuses its resume, its other alerts: "lands in 18 s; also link degraded"; or empty. */
export function due({ alert, also, blocks, next }) {
  const refused = blocks && blocks !== alert && `resume refused: ${blocks}`;
  const others = also.filter((each) => each !== blocks).join(", ");
  const change = next && `${next.does} in ${Math.ceil(next.in_s)}\u00a0s${next.cause === alert ? "" : ` (${next.cause})`}`;
  return [change, refused, others && alert ? `also ${others}` : others].filter(Boolean).join("; ");
}

/** Vehicles with the gravest trouble first, among them those that wait for a resume, then by number. */
export function byTrouble(team) {
  const rank = (vehicle) => (vehicle.is_unaccounted ? -1 : RANKS[trouble(vehicle, team)] - (vehicle.waits_for_resume ? 0.5 : 0));
  return team.vehicles.toSorted((a, b) => rank(a) - rank(b) || a.vehicle_id - b.vehicle_id);
}

/** How long ago the last data of a stale vehicle arrived; empty for a current one. */
export function lastSeen(vehicle) {
  if (!vehicle.is_stale) return "";
  const seen_s = Math.max(vehicle.age_s ?? 0, vehicle.link_age_s ?? 0);
  return vehicle.age_s === null ? "no message yet" : `last seen ${age(seen_s)} ago`;
}

/** The headline of a card: how it ended, its alert, that it is stale, or "no alert". */
export function headline(vehicle, team) {
  if (vehicle.in_reserve) return RESERVE;
  if (trouble(vehicle, team) === "ended") return ["ended", vehicle.ending].filter(Boolean).join(": ");
  return [alert(vehicle), lastSeen(vehicle)].filter(Boolean).join(", ") || "no alert";
}

const MISSING = "MISSING";
const TAKE_OFF = "take-off";

/** A vehicle's tactic with its ring if there are several, or that it takes off, and what the guard keeps doing meanwhile: "hold, evading 1". */
export function tactic(vehicle) {
  if (vehicle.is_unaccounted) return MISSING;
  if (vehicle.in_reserve) return RESERVE;
  const flies = [vehicle.tactic, vehicle.ring].filter(Boolean).join(" ");
  return [flies || (vehicle.mode === TAKE_OFF ? TAKE_OFF : UNKNOWN), vehicle.guard].filter(Boolean).join(", ");
}
