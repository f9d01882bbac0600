/** The rings and targets of missions and teams: those of a mission of one ring have numbers, too. */

/** The rings of a MissionPicture: name, target, colour, ring and ring_bounds; the only one has no name and colour. */
export function ringsOf(mission) {
  return mission.rings ?? [{ name: "", target: 0, colour: null, ring: mission.ring, ring_bounds: mission.ring_bounds }];
}

/** The radius, rate, altitude and tilt of a ring as commanded last, or the mission's. @param {?Object} team a TeamPicture */
export function flownRing(mission, team, number) {
  const commanded = (team?.rings ?? [team?.ring])[number];
  return ringsOf(mission)[number].ring.map((planned, index) => commanded?.[index] ?? planned);
}

/** The targets of a TeamPicture by their numbers, null for one of which nothing is known. */
export const targetsOf = (team) => team.targets ?? [team.target];

/** The names of the targets of a MissionPicture. */
export const targetNames = (mission) => (mission.targets ?? [""]).map((name) => name || "target");
