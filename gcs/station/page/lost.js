/** A flight whose process is gone while its vehicles may be in the air: why, since when, and what controls them now. */

import { byId, setText } from "./dom.js";
import { clock } from "./units.js";

/** Show a LostPicture at `wall_s`, or hide it without one. */
export function showLost(lost, wall_s) {
  byId("lost").hidden = !lost;
  if (!lost) return;
  const vehicles = lost.vehicles.length ? `Vehicle ${lost.vehicles.join(", ")}: ` : "";
  setText(byId("lost-what"), `${vehicles}no longer flown by cordon. The flight was lost`);
  setText(byId("lost-since"), clock(Math.max(0, wall_s - lost.since_wall_s)));
  setText(byId("lost-reason"), sentence(lost.reason));
  setText(byId("lost-autopilots"), sentence(lost.autopilots));
  setText(byId("lost-advice"), `→ ${sentence(lost.advice)} The page shows their last state.`);
}

const sentence = (clause) => `${clause.slice(0, 1).toUpperCase()}${clause.slice(1)}.`;
