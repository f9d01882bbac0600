/** Pointing at a place of the map: right click, long press, or a crosshair that the arrow keys move. */

import { byId, element, setAttribute } from "./dom.js";

const LONG_PRESS_MS = 500;
const MOVED_PX = 8;
const STEP_PX = 10;
const STRIDE_PX = 60;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export class Pointing {
  /**
   * @param {Object} map of MapLibre
   * @param {function({x: number, y: number}, boolean)} menu called with a pixel of the map to open a menu at, and whether by key
   * @param {function({x: number, y: number}, boolean): string} moved called with a pixel that is pointed at; returns its place as text
   * @param {function({x: number, y: number}): boolean} chosen called with a pixel chosen by key; returns whether it was taken
   */
  constructor(map, menu, moved, chosen) {
    Object.assign(this, { map, menu, moved, chosen });
    this.cross = element("button", { type: "button", id: "crosshair", "aria-haspopup": "menu", "aria-label": "Map cursor" });
    map.getContainer().append(this.cross);
    map.getCanvasContainer().addEventListener("contextmenu", (event) => {
      event.preventDefault();
      const { left, top } = map.getContainer().getBoundingClientRect();
      this.#open({ x: event.clientX - left, y: event.clientY - top }, false);
    });
    map.on("touchstart", (event) => this.#press(event));
    for (const end of ["touchend", "touchcancel", "movestart"]) map.on(end, () => clearTimeout(this.timer));
    map.on("touchmove", ({ point }) => far(point, this.pressed) && clearTimeout(this.timer));
    this.cross.addEventListener("focus", () => this.#place(this.pixel ?? this.#centre));
    this.cross.addEventListener("keydown", (event) => this.#key(event));
    this.cross.addEventListener("click", () => this.chosen(this.pixel) || this.#open(this.pixel, true));
  }

  /** Give the keyboard back to the crosshair. */
  focus() {
    this.cross.focus();
  }

  get #size() {
    const { clientWidth: width, clientHeight: height } = this.map.getContainer();
    return { width, height };
  }

  get #centre() {
    const { width, height } = this.#size;
    return { x: width / 2, y: height / 2 };
  }

  #open(pixel, isByKey) {
    clearTimeout(this.timer);
    this.menu(pixel, isByKey);
  }

  /** A finger that stays opens the menu; a second finger zooms. */
  #press({ point, points }) {
    clearTimeout(this.timer);
    this.pressed = point;
    if (points.length === 1) this.timer = setTimeout(() => this.#open(point, false), LONG_PRESS_MS);
  }

  #key(event) {
    if (event.key === "ContextMenu") {
      event.preventDefault();
      this.#open(this.pixel, true);
    }
    const [x, y] = ARROWS[event.key] ?? [0, 0];
    if (!x && !y) return;
    event.preventDefault();
    event.stopPropagation();
    const step = event.shiftKey ? STRIDE_PX : STEP_PX;
    this.#place({ x: this.pixel.x + step * x, y: this.pixel.y + step * y });
  }

  /** Move the crosshair; beyond the map's edge the map moves. */
  #place(wanted) {
    const { width, height } = this.#size;
    const pixel = { x: clamp(wanted.x, width), y: clamp(wanted.y, height) };
    const over = [wanted.x - pixel.x, wanted.y - pixel.y];
    if (over.some(Boolean)) this.map.panBy(over, { duration: 0 });
    this.pixel = pixel;
    this.cross.style.translate = `${pixel.x}px ${pixel.y}px`;
    setAttribute(this.cross, "aria-label", `Map cursor at ${this.moved(pixel, true)}. Arrow keys move it, Enter opens the menu`);
  }
}

const EDGE_PX = 22;

const clamp = (value, size) => Math.min(Math.max(value, EDGE_PX), Math.max(size - EDGE_PX, EDGE_PX));

const far = (point, from) => !from || Math.hypot(point.x - from.x, point.y - from.y) > MOVED_PX;
