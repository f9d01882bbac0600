/** Quantities as text. An unknown value is a dash, never 0. */

export const UNKNOWN = "–";

const isKnown = (value) => value !== null && value !== undefined;

/** @param {?number} value @param {number} digits @param {string} unit */
export function quantity(value, digits, unit) {
  return isKnown(value) ? `${withoutMinusZero(value.toFixed(digits))}\u00a0${unit}` : UNKNOWN;
}

function withoutMinusZero(text) {
  return /^-0(\.0*)?$/.test(text) ? text.slice(1) : text;
}

export const metres = (value) => quantity(value, 1, "m");

/** Speed over ground from a pair of components in m/s. */
export const speed = (velocity) => quantity(velocity && Math.hypot(...velocity), 1, "m/s");

export const degrees = (angle_rad) => quantity(isKnown(angle_rad) ? (angle_rad * 180) / Math.PI : null, 0, "°");

/** An age: tenths below ten seconds, then whole seconds, then minutes. */
export function age(seconds) {
  if (!isKnown(seconds)) return UNKNOWN;
  if (seconds < 10) return quantity(seconds, 1, "s");
  return seconds < 120 ? quantity(Math.floor(seconds), 0, "s") : quantity(Math.floor(seconds / 60), 0, "min");
}

/** Minutes and seconds: 3:05. */
export function clock(seconds) {
  if (!isKnown(seconds)) return UNKNOWN;
  const whole = Math.floor(Math.abs(seconds));
  return `${seconds <= -1 ? "−" : ""}${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

/** A share as whole percent, rounded down, so that a battery is never shown fuller than it is. */
export const percent = (share) => quantity(isKnown(share) ? Math.floor(share * 100 + 1e-6) : null, 0, "%");

/** Satellites and fix as text. */
export function positioning({ autopilot: { gps_dimensions, satellites } }) {
  const fix = isKnown(gps_dimensions) && (gps_dimensions ? `${gps_dimensions}D` : "no fix");
  return [fix, isKnown(satellites) && `${satellites}\u00a0sat`].filter(Boolean).join(", ") || UNKNOWN;
}

/** The nearest other vehicle and its distance. */
export function nearest(vehicle) {
  return isKnown(vehicle.nearest_m) ? `${metres(vehicle.nearest_m)} to\u00a0${vehicle.nearest_id}` : UNKNOWN;
}

export const capital = (text) => `${text.slice(0, 1).toUpperCase()}${text.slice(1)}`;

/** The names of vehicles in a sentence: "vehicle 2", "vehicles 1, 3", "all 3 vehicles". */
export function vehicleNames(chosen, all) {
  if (chosen.length === 1) return `vehicle ${chosen[0]}`;
  return chosen.length === all.length ? `all ${all.length} vehicles` : `vehicles ${chosen.join(", ")}`;
}
