/** The marks over the map as SVG in the mission's metres. Their colours, widths and dashes are in `style.css`. */

import { drawing, setAttribute } from "./dom.js";

/**
 * Two drawings, the lower one with the marks that seldom change: a browser draws the whole of a drawing that has changed.
 * In each the kinds of marks, with their layers from the lowest, and the switch that hides a layer.
 */
const DRAWINGS = [
  {
    plan: { zone: "zones", fence: "fence", start: "starts" },
    trails: { trail: "trails" },
  },
  {
    team: {
      "keep-out": "keep-out", ellipse: "uncertainty", reach: "uncertainty", camera: "cameras", ring: "ring", flown: "ring",
      velocity: "uncertainty", traffic: "traffic", separation: "separation", stale: "separation", setpoint: "setpoints",
    },
    measured: { measured: "" },
  },
];
const UNITS_PER_M = 100; // whole numbers are short
const STEP_M = 1;
const SCALE_CHANGE_MAX = 1e-4; // 0.2 pixels at 2000 pixels from the middle

export class Overlay {
  /** @param {Object} map of MapLibre, seen from above */
  constructor(map) {
    this.map = map;
    this.kinds = {};
    this.drawings = DRAWINGS.map((kinds) => this.#drawing(kinds));
    map.getCanvas().after(...this.drawings.map(({ root }) => root));
    map.on("move", () => this.#move());
    for (const end of ["moveend", "resize"]) map.on(end, () => this.#place());
  }

  /** Remove all marks; those that follow are in metres of this frame. */
  start(frame) {
    this.frame = frame;
    for (const layer of this.#layers) layer.replaceChildren();
    this.#place();
  }

  /** Draw marks in place of the last ones of this kind. @param {Object[]} marks as of `marks.js` */
  show(kind, marks) {
    for (const layer of this.kinds[kind]) {
      const paths = pathsOf(marks.filter((mark) => mark.layer === layer.dataset.layer));
      while (layer.childElementCount < paths.length) layer.append(drawing("path", {}));
      [...layer.children].forEach((path, number) => showPath(path, paths[number] ?? { colour: "", text: "" }));
    }
  }

  /** Show or hide the layers of a switch. */
  turn(belongs, isShown) {
    for (const layer of this.#layers) if (layer.dataset.switch === belongs) layer.toggleAttribute("hidden", !isShown);
  }

  get #layers() {
    return Object.values(this.kinds).flat();
  }

  #drawing(kinds) {
    const inside = drawing("g", {});
    for (const [kind, layers] of Object.entries(kinds)) {
      this.kinds[kind] = Object.entries(layers).map(([layer, belongs]) => drawing("g", { "data-layer": layer, "data-switch": belongs }));
      inside.append(...this.kinds[kind]);
    }
    const root = drawing("svg", { class: "marks", "aria-hidden": "true" });
    root.append(inside);
    return { root, inside };
  }

  /** Move the drawings with the map. Only a map that is zoomed or turned needs new ones. */
  #move() {
    if (!this.frame) return;
    const { scale, middle, middle_m } = this.#view();
    const change_max = SCALE_CHANGE_MAX * Math.hypot(scale[0], scale[1]);
    if (scale.some((each, index) => Math.abs(each - this.scale[index]) > change_max)) this.#place();
    else {
      const [x, y] = originOf(this.scale, middle, middle_m);
      for (const { root } of this.drawings) root.style.translate = `${x - this.origin[0]}px ${y - this.origin[1]}px`;
    }
  }

  /** Draw anew where the map is now. */
  #place() {
    if (!this.frame) return;
    const { scale, middle, middle_m } = this.#view();
    Object.assign(this, { scale, origin: originOf(scale, middle, middle_m) });
    const matrix = [...scale.map((each) => each / UNITS_PER_M), ...this.origin];
    for (const { root, inside } of this.drawings) {
      setAttribute(inside, "transform", `matrix(${matrix})`);
      root.style.translate = "none";
    }
  }

  /**
   * The middle of the map in pixels and in metres, and the pixels right and down of a metre of x and of y there. With
   * these all of the map is within 0.1 m up to 1 km from its middle.
   */
  #view() {
    const { lng, lat } = this.map.getCenter();
    const [x, y] = this.frame.point_m([lng, lat]);
    const [middle, ahead, left] = [[x, y], [x + STEP_M, y], [x, y + STEP_M]].map((point_m) => this.map.project(this.frame.lonLat(point_m)));
    const scale = [ahead.x - middle.x, ahead.y - middle.y, left.x - middle.x, left.y - middle.y].map((pixels) => pixels / STEP_M);
    return { scale, middle, middle_m: [x, y] };
  }
}

/** The pixel of the mission's origin. */
const originOf = ([a, b, c, d], { x, y }, [x_m, y_m]) => [x - a * x_m - c * y_m, y - b * x_m - d * y_m];

const lineText = (points_m) => `M${points_m.map(([x, y]) => `${units(x)} ${units(y)}`).join("L")}`;

const units = (metres) => Math.round(metres * UNITS_PER_M);

/** The paths of a layer's marks: lines of one colour share one. Areas do not, as two that overlap could leave a hole. */
function pathsOf(marks) {
  const paths = [];
  for (const { colour, isArea, parts_m } of marks) {
    const text = parts_m.map(lineText).join("");
    const shared = isArea ? undefined : paths.find((path) => path.colour === colour);
    if (shared) shared.text += text;
    else paths.push({ colour, text });
  }
  return paths;
}

/** A path without a colour of its own has its layer's. */
function showPath(path, { colour, text }) {
  setAttribute(path, "d", text);
  if (path.style.getPropertyValue("--own") !== colour) path.style.setProperty("--own", colour);
}
