/** Vehicles that may be in the air while cordon no longer flies them: why, since when, and what controls them now. */

import { byId, setText } from "./dom.js";
import { capital, clock, vehicleNames } from "./units.js";

/** Show the LostPicture of a team, or hide it without one. */
export function showLost({ lost, wall_s, vehicles }) {
  byId("lost").hidden = !lost;
  if (!lost) return;
  setText(byId("lost-what"), `${capital(vehicleNames(lost.vehicles, vehicles))}: unaccounted for. Not flown by cordon for`);
  setText(byId("lost-since"), clock(Math.max(0, wall_s - lost.since_wall_s)));
  setText(byId("lost-reason"), sentence(lost.reason));
  setText(byId("lost-autopilots"), lost.autopilots && sentence(lost.autopilots));
  setText(byId("lost-advice"), `→ ${sentence(lost.advice)}`);
}

const sentence = (clause) => `${capital(clause)}.`;
