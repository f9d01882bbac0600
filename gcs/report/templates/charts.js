/** Charts over time: values under the pointer, and zoom into a part of the time by a drag. Without this they are pictures. */

const NEAR_PT = 2; // beyond its ends by more, a line has no value
const DRAG_PX = 5;
const TICKS = 6;

class TimeChart {
  /** @param {SVGSVGElement} svg */
  constructor(svg) {
    this.svg = svg;
    this.panels = [...svg.querySelectorAll("[data-axes]")].map(panelOf);
    this.box = this.panels[0].box;
    this.shown = [this.box.left, this.box.right]; // the part that is shown, in points of the whole chart
    this.cursor = this.#add("line", { "stroke-width": 1, style: "stroke: var(--faint)" });
    this.span = this.#add("rect", { "fill-opacity": 0.15, style: "fill: var(--link)" });
    this.values = svg.parentElement.appendChild(Object.assign(document.createElement("output"), { className: "values", hidden: true }));
    this.whole = Object.assign(document.createElement("button"), { textContent: "Whole time", hidden: true, onclick: () => this.show(this.box.left, this.box.right) });
    svg.parentElement.querySelector("figcaption").append(this.whole);
    svg.addEventListener("pointerdown", (event) => this.#press(event));
    svg.addEventListener("pointermove", (event) => this.#move(event));
    svg.addEventListener("pointerup", (event) => this.#release(event));
    svg.addEventListener("pointerleave", (event) => event.pointerType === "touch" || this.#leave()); // a tap leaves values
    svg.addEventListener("pointercancel", () => this.#leave());
    addEventListener("scroll", () => this.#leave(), { passive: true });
    svg.addEventListener("dblclick", () => this.whole.click());
  }

  /** Show the time between two places of the whole chart. */
  show(from, to) {
    this.shown = [from, to];
    this.whole.hidden = from <= this.box.left && to >= this.box.right;
    for (const panel of this.panels) place(panel, (x) => this.#onScreen(x), this.whole.hidden ? null : [panel.timeAt(from), panel.timeAt(to)]);
  }

  #onScreen(x) {
    const { left, right } = this.box;
    return left + ((x - this.shown[0]) * (right - left)) / (this.shown[1] - this.shown[0]);
  }

  #inWhole(x) {
    const { left, right } = this.box;
    return this.shown[0] + ((x - left) * (this.shown[1] - this.shown[0])) / (right - left);
  }

  #add(name, attributes) {
    const element = this.svg.ownerDocument.createElementNS(this.svg.namespaceURI, name);
    for (const [key, value] of Object.entries({ ...attributes, visibility: "hidden", "pointer-events": "none" })) element.setAttribute(key, value);
    return this.svg.appendChild(element);
  }

  /** The place of an event inside the axes, in points. */
  #at(event) {
    const { left, right } = this.box;
    const x = new DOMPoint(event.clientX, event.clientY).matrixTransform(this.svg.getScreenCTM().inverse()).x;
    return Math.min(Math.max(x, left), right);
  }

  #press(event) {
    if (event.pointerType === "touch") this.#move(event); // a finger's drag scrolls the page
    if (event.pointerType === "touch" || event.button !== 0) return;
    this.pressed = { x: this.#at(event), client: event.clientX };
    this.svg.setPointerCapture(event.pointerId);
  }

  #move(event) {
    const x = this.#at(event);
    const [top, bottom] = [this.panels[0].box.top, this.panels.at(-1).box.bottom];
    set(this.cursor, { x1: x, x2: x, y1: top, y2: bottom, visibility: "visible" });
    if (this.pressed) set(this.span, { x: Math.min(x, this.pressed.x), width: Math.abs(x - this.pressed.x), y: top, height: bottom - top, visibility: "visible" });
    this.#tell(x, event);
  }

  #release(event) {
    const { pressed } = this;
    if (pressed) this.#leave();
    if (pressed && Math.abs(event.clientX - pressed.client) > DRAG_PX) {
      const [from, to] = [pressed.x, this.#at(event)].sort((a, b) => a - b).map((x) => this.#inWhole(x));
      this.show(from, to);
    }
  }

  #leave() {
    this.pressed = null;
    this.values.hidden = true;
    for (const element of [this.cursor, this.span]) set(element, { visibility: "hidden" });
  }

  #tell(x, event) {
    const whole = this.#inWhole(x);
    const near = (NEAR_PT * (this.shown[1] - this.shown[0])) / (this.box.right - this.box.left);
    const rows = this.panels.flatMap((panel) => panel.lines.map((line) => [line, valueAt(panel, line, whole, near)])).filter(([, value]) => value !== null);
    this.values.replaceChildren(row(`${this.panels[0].timeAt(whole).toFixed(1)} s`, ""), ...rows.map(([line, value]) => row(`${line.label}: ${Number(value.toPrecision(4))}`, line.colour)));
    this.values.hidden = false;
    const { offsetWidth: width, offsetHeight: height } = this.values;
    const left = event.clientX + 16 + width > innerWidth ? Math.max(4, event.clientX - 16 - width) : event.clientX + 16;
    Object.assign(this.values.style, { left: `${left}px`, top: `${Math.max(4, Math.min(event.clientY + 12, innerHeight - height - 4))}px` });
  }
}

/** The axes of a panel, its lines, and what moves when it is zoomed. */
function panelOf(group) {
  const { box, time_s: time, limits, is_logarithmic: isLogarithmic } = JSON.parse(group.dataset.axes);
  const [left, top, right, bottom] = box;
  const own = (selector) => [...group.querySelectorAll(selector)].filter((each) => !each.closest(".axis, .legend"));
  const share = (y) => (bottom - y) / (bottom - top);
  return {
    box: { left, top, right, bottom },
    timeAt: (x) => time[0] + ((x - left) * (time[1] - time[0])) / (right - left),
    placeOf: (seconds) => left + ((seconds - time[0]) * (right - left)) / (time[1] - time[0]),
    value: (y) => (isLogarithmic ? limits[0] * (limits[1] / limits[0]) ** share(y) : limits[0] + share(y) * (limits[1] - limits[0])),
    lines: own("[data-label]").map((line) => lineOf(line)).filter((line) => line.points.length),
    paths: own("path[clip-path]").map((path) => ({ path, d: path.getAttribute("d") })),
    marks: own("use").map((mark) => ({ mark, x: Number(mark.getAttribute("x")) })),
    texts: own("text").map((text) => ({ text, x: Number(text.getAttribute("x")) })).filter(({ x }) => x > left && x < right - 3),
    axis: group.querySelector(".axis"),
  };
}

function lineOf(group) {
  const path = group.querySelector("path");
  const parts = (path?.getAttribute("d") ?? "").matchAll(/([ML]) ?(-?[\d.]+) (-?[\d.]+)/g);
  const points = [...parts].map(([, letter, x, y]) => ({ starts: letter === "M", x: Number(x), y: Number(y) }));
  return { label: group.dataset.label, colour: path?.style.stroke ?? "", points };
}

/** The value of a line at a place: between two points of it, or that of an end that is near; null elsewhere. */
function valueAt(panel, { points }, x, near) {
  let [low, high] = [0, points.length - 1];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (points[middle].x < x) low = middle + 1;
    else high = middle;
  }
  const [before, after] = [points[low - 1], points[low]];
  if (before && !after.starts && after.x >= x) return panel.value(before.y + ((after.y - before.y) * (x - before.x)) / (after.x - before.x || 1));
  const end = [after, before].find((each) => each && Math.abs(each.x - x) <= near);
  return end ? panel.value(end.y) : null;
}

/** Move everything of a panel to where it is on the screen; `times` are the limits of the time that is shown, null: all. */
function place(panel, onScreen, times) {
  const { left, right } = panel.box;
  for (const { path, d } of panel.paths) path.setAttribute("d", times ? d.replace(/(-?[\d.]+) (-?[\d.]+)/g, (_, x, y) => `${onScreen(Number(x)).toFixed(2)} ${y}`) : d);
  const inside = (x) => (x >= left - 1 && x <= right + 1 ? "visible" : "hidden");
  for (const { mark, x } of panel.marks) set(mark, { x: onScreen(x), visibility: inside(onScreen(x)) });
  for (const { text, x } of panel.texts) set(text, { x: onScreen(x), transform: "", visibility: inside(onScreen(x)) });
  const ticks = [...panel.axis.querySelectorAll(".xtick:not(.zoomed)")];
  for (const old of panel.axis.querySelectorAll(".zoomed")) old.remove();
  for (const tick of ticks) tick.style.display = times ? "none" : "";
  if (!times || !ticks.length) return;
  for (const seconds of ticksOf(...times)) panel.axis.append(tickAt(ticks.at(-1), seconds, onScreen(panel.placeOf(seconds))));
}

function tickAt(template, seconds, x) {
  const tick = template.cloneNode(true);
  tick.classList.add("zoomed");
  tick.style.display = "";
  tick.setAttribute("transform", `translate(${x - Number(tick.querySelector("use").getAttribute("x"))} 0)`);
  for (const text of tick.querySelectorAll("text")) text.textContent = `${seconds}`;
  return tick;
}

/** Even times between two, at a distance of 1, 2 or 5 in some power of ten. */
function ticksOf(from, to) {
  const power = 10 ** Math.floor(Math.log10((to - from) / TICKS));
  const step = power * [1, 2, 5, 10].find((each) => (to - from) / (each * power) <= TICKS);
  const first = Math.ceil(from / step);
  return Array.from({ length: Math.floor(to / step) - first + 1 }, (_, index) => Number(((first + index) * step).toPrecision(10)));
}

function row(text, colour) {
  const line = Object.assign(document.createElement("div"), { textContent: text });
  if (colour) line.style.borderLeft = `0.3rem solid ${colour}`;
  return line;
}

const set = (element, attributes) => Object.entries(attributes).forEach(([name, value]) => element.setAttribute(name, value));

const charts = [...document.querySelectorAll("figure svg")].filter((svg) => svg.querySelector("[data-axes]")).map((svg) => new TimeChart(svg));
document.getElementById("charts-hint").hidden = !charts.length;
