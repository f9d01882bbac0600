/** Vehicles that may be in the air while cordon no longer flies them: why, since when, and what controls them now. */

import { byId, setText } from "./dom.js";
import { clock } from "./units.js";

/** Show a LostPicture at `wall_s`, or hide it without one. */
export function showLost(lost, wall_s) {
  byId("lost").hidden = !lost;
  if (!lost) return;
  const vehicles = `Vehicle${lost.vehicles.length > 1 ? "s" : ""} ${lost.vehicles.join(", ")}`;
  setText(byId("lost-what"), `${vehicles}: unaccounted for. Not flown by cordon for`);
  setText(byId("lost-since"), clock(Math.max(0, wall_s - lost.since_wall_s)));
  setText(byId("lost-reason"), sentence(lost.reason));
  setText(byId("lost-autopilots"), lost.autopilots && sentence(lost.autopilots));
  setText(byId("lost-advice"), `→ ${sentence(lost.advice)} The page shows their last state.`);
}

const sentence = (clause) => `${clause.slice(0, 1).toUpperCase()}${clause.slice(1)}.`;
