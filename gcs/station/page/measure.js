/** Distance and bearing between two places of the map. */

import { byId, setText } from "./dom.js";
import { line } from "./marks.js";

export class Measure {
  /** @param {function(Object)} draw called with marks @param {function()} ended called when the measurement ends */
  constructor(draw) {
    this.draw = draw;
    this.button = byId("measure");
    this.end();
    this.button.addEventListener("click", () => (this.isOn ? this.end() : this.begin()));
    document.addEventListener("keydown", (event) => event.key === "Escape" && !event.defaultPrevented && this.isOn && this.end());
  }

  start(mission, frame) {
    Object.assign(this, { mission, frame });
    this.end();
  }

  get isOn() {
    return this.state !== "off";
  }

  /** Begin; with a first place if there is one already. */
  begin(point_m = null) {
    Object.assign(this, { state: point_m ? "to" : "from", from: point_m, to: null });
    this.#show();
  }

  end() {
    Object.assign(this, { state: "off", from: null, to: null });
    this.#show();
  }

  /** Show the way to a place that is pointed at. */
  move(point_m) {
    if (this.state !== "to") return;
    this.to = point_m;
    this.#show();
  }

  /** Take a place; returns whether it was wanted. */
  take(point_m) {
    if (!this.isOn) return false;
    if (this.state === "to") Object.assign(this, { state: "done", to: point_m });
    else Object.assign(this, { state: "to", from: point_m, to: null });
    this.#show();
    return true;
  }

  #show() {
    this.button.setAttribute("aria-pressed", String(this.isOn));
    byId("measured").hidden = !this.isOn;
    const said = this.state === "from" ? "Choose the first place" : this.to ? wayText(this.from, this.to, this.frame, this.mission) : "Choose the second place";
    setText(byId("measured"), said);
    if (this.state === "done") setText(byId("polite"), said);
    this.draw(this.from && this.to ? [line("measured", [[this.from, this.to]])] : []);
  }
}

/** Distance, and bearing from true north; in a local frame the direction from the mission's x axis, counter-clockwise. */
export function wayText([x, y], [to_x, to_y], frame, mission) {
  const away_m = Math.hypot(to_x - x, to_y - y);
  const distance = `${away_m.toFixed(1)} m`;
  if (away_m === 0) return distance;
  const direction = Math.atan2(to_y - y, to_x - x);
  if (!mission.origin_deg) return `${distance}, ${turned((direction * 180) / Math.PI)} from x`;
  return `${distance}, bearing ${turned(frame.bearing_deg(direction))}`;
}

const turned = (degrees) => `${((Math.round(degrees * 10) / 10 + 720) % 360).toFixed(1)}°`;
