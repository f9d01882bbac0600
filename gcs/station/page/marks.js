/** The marks of a mission and a team: lines in metres, each with its layer, and its colour if it has one of its own. */

import { flownRing, ringsOf, targetsOf } from "./rings.js";
import { trouble } from "./vehicles.js";

const CIRCLE = unitCircle(64);
const SMALL_CIRCLE = unitCircle(32); // 0.5 % of its radius inside the circle at most
const DEVIATIONS = 2; // the ellipse contains the target with a probability of 86 %
const VELOCITY_SHOWN_S = 10;
const TRAIL_STEP_M = 0.5;
const FAR_M = 100; // a camera that looks along the ground covers it to the horizon

/** The fence, the no-fly zones and the starts, which are constant. */
export function planMarks(mission) {
  const fences = new Map(mission.vehicles.filter(hasFence).map((each) => [JSON.stringify(each.fence_m), each.fence_m]));
  const starts = mission.vehicles.map((each) => line("start", cross(each.start_m, 0.6), each.colour));
  const zones = (mission.zones ?? []).map((zone) => area("zone", zoneLine(zone)));
  return [...zones, ...[...fences.values()].map((fence_m) => line("fence", [closed(fence_m)])), ...starts];
}

/** The closed line around a no-fly zone. */
export function zoneLine({ polygon_m, center_m, radius_m }) {
  return polygon_m.length ? closed(polygon_m) : circle(center_m, radius_m);
}

/** Where the name of a zone is: the middle of its box. */
export function zoneMiddle(zone) {
  const line_m = zoneLine(zone);
  return [0, 1].map((axis) => {
    const values = line_m.map((point_m) => point_m[axis]);
    return (Math.min(...values) + Math.max(...values)) / 2;
  });
}

const hasFence = (vehicle) => vehicle.fence_m.length > 2;

/** The targets with their rings, and the setpoints or aims and circles of vehicles, of a TeamPicture. */
export function teamMarks(mission, team) {
  const targets = targetsOf(team).flatMap((target, number) => (target ? targetMarks(mission, team, number) : []));
  const traffic = (team.traffic ?? []).map((each) => trafficMark(each));
  return [...targets, ...traffic, ...team.vehicles.flatMap((vehicle) => vehicleMarks(mission, vehicle, team))];
}

function targetMarks(mission, team, number) {
  const target = targetsOf(team)[number];
  const centre = target.position_m;
  const marks = whereabouts(target, centre);
  if (mission.keep_out_m > 0) marks.push(area("keep-out", circle(centre, mission.keep_out_m)));
  return [...ringsOf(mission).flatMap((ring, index) => (ring.target === number ? ringMarks(mission, team, index, centre) : [])), ...marks];
}

/** The circle of a ring as it is wanted, and as it is flown. */
function ringMarks(mission, team, number, centre) {
  const { name, colour } = ringsOf(mission)[number];
  const wanted = line("ring", [circle(centre, flownRing(mission, team, number)[0])], colour);
  const flown = flownRadius(team.vehicles.filter((each) => !name || each.ring === name));
  return flown === null ? [wanted] : [wanted, line("flown", [circle(centre, flown)], colour)];
}

/** A point of a ring for its name; those of several rings about one target are apart. */
export function namePlace(mission, number, centre, radius) {
  const angle = Math.PI / 2 + (2 * Math.PI * number) / ringsOf(mission).length;
  return [centre[0] + radius * Math.cos(angle), centre[1] + radius * Math.sin(angle)];
}

/** Where the target is: its ellipse and motion, or for a lost one the circle that it can have reached. */
function whereabouts(target, centre) {
  if (target.lost_speed_m_s !== null) return [area("reach", circle(centre, reach(target)))];
  return [
    line("velocity", [[centre, ahead(centre, target.velocity_m_s)]]),
    area("ellipse", ellipse(centre, target.covariance_m2)),
  ];
}

/** How far, in metres, a lost target can be from its last place: its speed for as long, and its last uncertainty. */
export function reach({ lost_speed_m_s, sighting_age_s, covariance_m2: [xx, , yy] }) {
  return lost_speed_m_s * sighting_age_s + DEVIATIONS * Math.sqrt(xx + yy);
}

/** The mean radius, in metres, of vehicles on the ring that are current; null for none. */
export function flownRadius(vehicles) {
  const radii = vehicles.filter((each) => !each.is_stale && each.tactic === "encircle" && each.radius_m !== null);
  return radii.length ? radii.reduce((sum, each) => sum + each.radius_m, 0) / radii.length : null;
}

/** An aircraft outside the team, with its way in `VELOCITY_SHOWN_S`. */
function trafficMark({ position_m, velocity_m_s }) {
  return line("traffic", [[position_m, ahead(position_m, velocity_m_s)], ...cross(position_m, 3)]);
}

/** What a camera covers of the ground at the origin's height, to `FAR_M` from the vehicle: where its cone of view meets it. */
export function footprint({ position_m: [x, y, height], elevation_rad, bearing_rad, view_rad }) {
  const [up, across] = [Math.sin(elevation_rad), Math.cos(elevation_rad)];
  const [east, north] = [Math.cos(bearing_rad), Math.sin(bearing_rad)];
  const [ahead, aside] = [Math.cos(view_rad / 2), Math.sin(view_rad / 2)];
  return CIRCLE.map(([cosine, sine]) => {
    const along = ahead * across - aside * sine * up; // of the ray, horizontally along the camera's bearing
    const [dx, dy] = [along * east - aside * cosine * north, along * north + aside * cosine * east];
    const sinks = -(ahead * up + aside * sine * across);
    const horizontal = Math.hypot(dx, dy);
    const length = Math.min(sinks > 0 ? Math.max(height, 0) / sinks : Infinity, FAR_M / Math.max(horizontal, 1e-9));
    return [x + length * dx, y + length * dy];
  });
}

function vehicleMarks(mission, vehicle, team) {
  if (vehicle.position_m === null) return [];
  const { colour } = mission.vehicles.find((each) => each.vehicle_id === vehicle.vehicle_id);
  const isCurrent = !["stale", "ended"].includes(trouble(vehicle, team)) && !vehicle.is_stale;
  const round = circle(vehicle.position_m, mission.separation_m / 2, SMALL_CIRCLE);
  const marks = [line(isCurrent ? "separation" : "stale", [round], colour)];
  const { camera } = vehicle.autopilot;
  if (isCurrent && camera) marks.push(area("camera", footprint(camera), colour));
  const ahead_m = vehicle.setpoint_m ?? vehicle.aim_m;
  if (!isCurrent || ahead_m === null) return marks;
  return [...marks, line("setpoint", [[vehicle.position_m, ahead_m], ...cross(ahead_m, 0.4)], colour)];
}

/** The trails of the vehicles, from TeamPictures in the order of time, with gaps where a vehicle was stale. */
export function trailMarks(mission, teams) {
  return mission.vehicles.map((planned) => trail(planned, teams));
}

function trail({ vehicle_id, colour }, teams) {
  const parts = [[]];
  for (const team of teams) {
    const vehicle = team.vehicles.find((each) => each.vehicle_id === vehicle_id);
    const part = parts.at(-1);
    if (!vehicle?.position_m || vehicle.is_stale) part.length && parts.push([]);
    else if (!part.length || distance(vehicle.position_m, part.at(-1)) >= TRAIL_STEP_M) part.push(vehicle.position_m);
  }
  return line("trail", parts.filter((part) => part.length > 1), colour);
}

/** A mark of lines through points in metres; without a colour it has its layer's. */
export const line = (layer, parts_m, colour = null) => ({ layer, parts_m, colour: colour ?? "", isArea: false });

const area = (layer, points_m, colour = null) => ({ ...line(layer, [points_m], colour), isArea: true });

const distance = ([x, y], [x_2, y_2]) => Math.hypot(x_2 - x, y_2 - y);

const closed = (points) => [...points, points[0]];

const ahead = ([x, y], velocity) => [x + VELOCITY_SHOWN_S * velocity[0], y + VELOCITY_SHOWN_S * velocity[1]];

function cross([x, y], arm) {
  return [[[x - arm, y - arm], [x + arm, y + arm]], [[x - arm, y + arm], [x + arm, y - arm]]];
}

function circle(centre, radius, turns = CIRCLE) {
  return ellipse(centre, [(radius / DEVIATIONS) ** 2, 0, (radius / DEVIATIONS) ** 2], turns);
}

/** The ellipse of `DEVIATIONS` standard deviations of a covariance (xx, xy, yy), by its Cholesky factor. */
function ellipse([x, y], [xx, xy, yy], turns = CIRCLE) {
  const a = DEVIATIONS * Math.sqrt(Math.max(xx, 1e-12));
  const b = (DEVIATIONS ** 2 * xy) / a;
  const c = Math.sqrt(Math.max(DEVIATIONS ** 2 * yy - b * b, 0));
  return turns.map(([cosine, sine]) => [x + a * cosine, y + b * cosine + c * sine]);
}

/** Cosine and sine of evenly spaced angles, the first one again at the end. */
function unitCircle(points) {
  const turns = Array.from({ length: points + 1 }, (_, index) => (2 * Math.PI * index) / points);
  return turns.map((turn) => [Math.cos(turn), Math.sin(turn)]);
}
