/** The log of events, newest first, with their severity as a word. */

import { element, SEVERITIES, setText } from "./dom.js";
import { clock } from "./units.js";

const EVENTS_MAX = 500;
const SETTLE_MS = 1000;

export class Events {
  /** @param {HTMLElement} list @param {HTMLElement} live a polite live region */
  constructor(list, live) {
    this.list = list;
    this.live = live;
    this.last = 0;
    this.quietUntil_ms = Infinity;
  }

  /** Clear the log: events from before the page was opened are shown, and not read out. */
  start() {
    this.list.replaceChildren();
    this.last = 0;
    this.quietUntil_ms = performance.now() + SETTLE_MS;
  }

  /** Add an EventPicture, once. */
  add(event) {
    if (event.number <= this.last) return;
    this.last = event.number;
    this.list.prepend(row(event));
    while (this.list.children.length > EVENTS_MAX) this.list.lastChild.remove();
    if (performance.now() > this.quietUntil_ms) setText(this.live, sentence(event));
  }

  /** Show the events of a recorded flight up to a time. */
  showUntil(events, time_s) {
    const past = events.filter((event) => (event.time_s ?? 0) <= time_s).slice(-EVENTS_MAX);
    const last = past.at(-1)?.number ?? 0;
    if (last === this.last) return;
    this.last = last;
    this.list.replaceChildren(...past.toReversed().map(row));
  }
}

function row(event) {
  const { sign, word } = SEVERITIES[event.severity];
  return element(
    "li",
    { "data-severity": event.severity, "data-number": event.number },
    element("span", { class: "time" }, clock(event.time_s)),
    element("span", { class: "severity" }, `${sign} ${word}`),
    element("span", { class: "text" }, subject(event) + event.text),
  );
}

const subject = (event) => (event.vehicle_id === null ? "" : `Vehicle ${event.vehicle_id}: `);

const sentence = (event) => `${SEVERITIES[event.severity].word}: ${subject(event)}${event.text}`;
