/** Places as text: latitude and longitude in degrees, or the mission's metres in a local frame. A click copies them. */

import { byId, setText } from "./dom.js";
import { Frame } from "./frame.js";
import { UNKNOWN } from "./units.js";

const COPIED_MS = 1500;
const frames = new WeakMap();

/** The frame of a mission, made once. */
function frameOf(mission) {
  if (!frames.has(mission)) frames.set(mission, new Frame(mission));
  return frames.get(mission);
}

/** A point of the mission in metres as text; a dash if it is not known. @param {?number[]} point_m */
export function placeText(mission, point_m) {
  if (!point_m) return UNKNOWN;
  if (!mission.origin_deg) return `x ${point_m[0].toFixed(1)} m, y ${point_m[1].toFixed(1)} m`;
  const [longitude_deg, latitude_deg] = frameOf(mission).lonLat(point_m);
  return `${latitude_deg.toFixed(6)}, ${longitude_deg.toFixed(6)}`;
}

/** A point of the mission as text in metres, and with an origin in degrees as well. @param {number[]} point_m */
export function fullPlaceText(mission, point_m) {
  const metres = `x ${point_m[0].toFixed(1)} m, y ${point_m[1].toFixed(1)} m`;
  return mission.origin_deg ? `${metres}; ${placeText(mission, point_m)}` : metres;
}

/** A point of the map as text. @param {number[]} lonLat_deg longitude and latitude, on the map's sphere in a local frame */
export function mapPlaceText(mission, lonLat_deg) {
  return placeText(mission, frameOf(mission).point_m(lonLat_deg));
}

/** Copy the text of what is clicked, if it is inside `root` and has the class "copies"; a live region says so. */
export function copyOnClick(root) {
  root.addEventListener("click", (event) => {
    const clicked = event.target.closest(".copies");
    if (clicked && root.contains(clicked)) copy(clicked.dataset.copied ?? clicked.textContent, clicked);
  });
}

/** Copy a text; the node shows it for a moment. */
export function copy(text, node) {
  if (!text || text === UNKNOWN) return;
  write(text);
  node.classList.add("copied");
  setTimeout(() => node.classList.remove("copied"), COPIED_MS);
  setText(byId("polite"), `Copied: ${text}`);
}

/** The clipboard needs a secure context; without one the text is selected and copied as by a user. */
function write(text) {
  if (navigator.clipboard) {
    navigator.clipboard.writeText(text).catch(() => writeBySelection(text));
  } else {
    writeBySelection(text);
  }
}

function writeBySelection(text) {
  const field = document.createElement("textarea");
  field.value = text;
  document.body.append(field);
  field.select();
  document.execCommand("copy");
  field.remove();
}
