/** Strips: recent radius, distance, height and speed, one line per vehicle. */

import uPlot from "./vendor/uPlot.esm.js";
import { drawing, element } from "./dom.js";
import { atMostEvery } from "./throttle.js";

const STRIPS = [
  ["Radius, m", (vehicle) => vehicle.radius_m],
  ["Nearest other vehicle, m", (vehicle) => vehicle.nearest_m],
  ["Height, m", (vehicle) => vehicle.position_m?.[2]],
  ["Speed, m/s", (vehicle) => vehicle.velocity_m_s && Math.hypot(...vehicle.velocity_m_s)],
];
const DASHES = [[], [8, 3], [2, 3], [8, 3, 2, 3]];
const HEIGHT_PX = 150;
const EVERY_MS = 500;

export class Strips {
  /** @param {HTMLElement} container */
  constructor(container) {
    this.container = container;
    this.update = atMostEvery(EVERY_MS, (teams) => this.#draw(teams));
    this.plots = [];
    new ResizeObserver(() => this.#resize()).observe(container);
  }

  start(mission) {
    this.mission = mission;
    this.recolour();
  }

  /** Create the plots again, in the page's colours. */
  recolour() {
    for (const { plot } of this.plots) plot.destroy();
    this.container.replaceChildren();
    if (!this.mission) return;
    this.container.append(legend(this.mission.vehicles));
    this.plots = STRIPS.map(([title, value]) => ({ value, plot: this.#plot(title) }));
  }

  /** Draw TeamPictures in the order of time, if the strips are on the screen. */
  #draw(teams) {
    if (this.container.closest("[hidden]")) return; // this test needs no new layout of the page
    const timed = teams.filter((team) => team.time_s !== null);
    const times = timed.map((team) => team.time_s);
    for (const { value, plot } of this.plots) plot.setData([times, ...this.mission.vehicles.map((each) => series(each, timed, value))]);
  }

  #plot(title) {
    const figure = element("figure", { "aria-label": title }, element("figcaption", {}, title));
    this.container.append(figure);
    const ink = getComputedStyle(this.container).color;
    const axis = { stroke: ink, grid: { stroke: `${toTransparent(ink)}`, width: 1 }, ticks: { show: false } };
    const options = {
      width: Math.max(this.container.clientWidth - 8, 100), height: HEIGHT_PX, legend: { show: false },
      cursor: { show: false }, scales: { x: { time: false } }, axes: [axis, { ...axis, size: 46 }],
      series: [{}, ...this.mission.vehicles.map(seriesStyle)],
    };
    return new uPlot(options, [[], ...this.mission.vehicles.map(() => [])], figure);
  }

  #resize() {
    const width = this.container.clientWidth - 8;
    if (width > 0) for (const { plot } of this.plots) plot.setSize({ width, height: HEIGHT_PX });
  }
}

function series(planned, teams, value) {
  return teams.map((team) => {
    const vehicle = team.vehicles.find((each) => each.vehicle_id === planned.vehicle_id);
    return vehicle && !vehicle.is_stale ? (value(vehicle) ?? null) : null;
  });
}

const COLOURS_OF_VEHICLES = 8;

const dashes = (index) => DASHES[Math.floor(index / COLOURS_OF_VEHICLES) % DASHES.length];

function seriesStyle(planned, index) {
  return { label: `${planned.vehicle_id}`, stroke: planned.colour, width: 1.5, dash: dashes(index), points: { show: false } };
}

/** The number of each vehicle beside its line. */
function legend(vehicles) {
  const keys = vehicles.map(({ vehicle_id, colour }, index) => {
    const line = drawing("line", { x1: 0, x2: 28, y1: 5, y2: 5, stroke: colour, "stroke-width": 2.5, "stroke-dasharray": dashes(index).join(" ") });
    const picture = drawing("svg", { width: 28, height: 10, "aria-hidden": "true" });
    picture.append(line);
    return element("li", {}, picture, ` ${vehicle_id}`);
  });
  return element("ul", { class: "legend", "aria-label": "Lines of the vehicles" }, ...keys);
}

const toTransparent = (colour) => colour.replace("rgb(", "rgba(").replace(")", ", 0.15)");
