/** A recorded flight: the time slider, play and pause, the speed, and jumps to events. */

import { byId, element, setText } from "./dom.js";
import { clock } from "./units.js";

const FRAME_MS_MAX = 250;

export class Replay {
  /** @param {Object} flight a FlightPicture @param {function(number)} show called with the index of a picture */
  constructor(flight, show) {
    this.flight = flight;
    this.show = show;
    this.place = 0; // in pictures, with a fraction
    this.isPlaying = false;
    this.times = flight.teams.map((team) => team.time_s ?? 0);
    this.period_s = period(flight.teams);
    setText(byId("rate"), rate(this.period_s));
    byId("replay").hidden = false;
    byId("seek").max = this.times.length - 1;
    byId("seek").addEventListener("input", () => this.seek(byId("seek").valueAsNumber));
    byId("play").addEventListener("click", () => this.play(!this.isPlaying));
    byId("next-event").addEventListener("click", () => this.#jump(1));
    byId("previous-event").addEventListener("click", () => this.#jump(-1));
    this.#offerAlarms(this.#places((event) => event.severity === "alarm"));
    this.seek(Math.max(flight.teams.findIndex((team) => team.time_s !== null), 0)); // where the mission begins
  }

  /** Show the picture at a place. */
  seek(place) {
    this.place = Math.min(Math.max(place, 0), this.times.length - 1);
    const index = Math.floor(this.place);
    const text = `${clock(this.times[index])} of ${clock(this.times.at(-1))}`;
    byId("seek").value = index;
    byId("seek").setAttribute("aria-valuetext", text);
    setText(byId("seek-time"), text);
    if (index !== this.shown) this.show(index);
    this.shown = index;
  }

  /** Play or pause; at the end, from the beginning. */
  play(isPlaying) {
    this.isPlaying = isPlaying;
    setText(byId("play"), isPlaying ? "Pause" : "Play");
    if (!isPlaying) return;
    if (this.place >= this.times.length - 1) this.place = 0;
    this.#frame(performance.now());
  }

  #frame(last_ms) {
    requestAnimationFrame((now_ms) => {
      if (!this.isPlaying) return;
      const passed_s = Math.min(Math.max(now_ms - last_ms, 0), FRAME_MS_MAX) / 1000;
      this.seek(this.place + (passed_s * Number(byId("speed").value)) / (this.period_s || 1));
      if (this.place < this.times.length - 1) this.#frame(now_ms);
      else this.play(false);
    });
  }

  /** Mark alarms on the slider, and let a button and a key seek the next one; after the last one they do nothing. */
  #offerAlarms(places) {
    const last = Math.max(this.times.length - 1, 1);
    byId("seek-alarms").replaceChildren(...[...new Set(places)].map((place) => mark(place / last)));
    byId("next-alarm").disabled = places.length === 0;
    const seekNext = () => {
      const next = Math.min(...places.filter((place) => place > Math.floor(this.place)));
      if (Number.isFinite(next)) this.seek(next);
    };
    byId("next-alarm").addEventListener("click", seekNext);
    document.addEventListener("keydown", (event) => event.key === "n" && !isModified(event) && seekNext());
  }

  /** The places of the first pictures after events. */
  #places(isWanted) {
    const times = this.flight.events.filter((event) => event.time_s !== null && isWanted(event)).map(({ time_s }) => time_s);
    return times.map((time_s) => this.times.findIndex((each) => each >= time_s)).filter((place) => place >= 0);
  }

  /** Seek the first picture after the next or the previous event; without one the end or the beginning. */
  #jump(direction) {
    const now = Math.floor(this.place);
    const places = this.#places(() => true);
    if (direction > 0) this.seek(Math.min(...places.filter((place) => place > now), this.times.length - 1));
    else this.seek(Math.max(...places.filter((place) => place < now), 0));
  }
}

const isModified = (event) => event.ctrlKey || event.altKey || event.metaKey;

/** A mark on the slider at a share of its length. */
function mark(share) {
  const made = element("span");
  made.style.setProperty("--share", String(share));
  return made;
}

/** The time between two pictures, in seconds of the mission; 0 where it never began. */
function period(teams) {
  const times = teams.map((team) => team.time_s).filter((time_s) => time_s !== null);
  return times.length > 1 ? (times.at(-1) - times[0]) / (times.length - 1) : 0;
}

/** The rate of the pictures as text: long flights have fewer. */
function rate(period_s) {
  if (period_s === 0) return "";
  return period_s < 1 ? `${Math.round(10 / period_s) / 10} pictures a second` : `a picture every ${Math.round(10 * period_s) / 10} s`;
}
