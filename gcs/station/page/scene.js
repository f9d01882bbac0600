/** The map: the mission's metres with MapLibre's camera, lines from `marks.js` and symbols from `symbols.js`. */

import { byId, setAttribute, setText } from "./dom.js";
import { Frame } from "./frame.js";
import { labelPlaces } from "./labels.js";
import { MapMenu } from "./map_menu.js";
import { namePlace, planMarks, teamMarks, trailMarks, zoneLine, zoneMiddle } from "./marks.js";
import { Measure } from "./measure.js";
import { Overlay } from "./overlay.js";
import { copy, copyOnClick, frameOf, fullPlaceText, placeText } from "./places.js";
import { Pointing } from "./pointing.js";
import { flownRing, ringsOf, targetNames, targetsOf } from "./rings.js";
import { ringSymbol, showTarget, showTraffic, showVehicle, targetSymbol, trafficSymbol, vehicleSymbol, zoneSymbol } from "./symbols.js";
import { otherSymbol } from "./teams.js";
import { atMostEvery } from "./throttle.js";
import { byTrouble, trouble } from "./vehicles.js";
import { Tiles } from "./tiles.js";
import * as maplibre from "./vendor/maplibre-gl.mjs";

const PADDING_PX = { top: 40, bottom: 50, left: 50, right: 110 }; // labels are on the right
const ZOOM_MAX = 21.5;
const TRAIL_EVERY_MS = 500;
const WITHOUT_ZONES = "without-zones";
const STYLE = { version: 8, sources: {}, layers: [] }; // the page draws the ground, `tiles.js` the tiles, `overlay.js` the rest

maplibre.setWorkerUrl(import.meta.resolve("./vendor/maplibre-gl-worker.mjs")); // in a report it is not beside the library

export class Scene {
  /**
   * @param {HTMLElement} container @param {Selection} selection @param {function(): Object} headers of requests for tiles
   * @param {function(number[], string): Object[]} choices what a menu offers at a place in metres, which the text describes
   */
  constructor(container, selection, headers, choices) {
    this.selection = selection;
    this.choices = choices;
    this.isFollowing = true;
    this.drawTrails = atMostEvery(TRAIL_EVERY_MS, (past) => this.overlay.show("trails", trailMarks(this.mission, past)));
    this.map = new maplibre.Map({
      container, style: STYLE, maxZoom: ZOOM_MAX, maxPitch: 0, attributionControl: false, dragRotate: false,
      renderWorldCopies: false, fadeDuration: 0, center: [0, 0], zoom: 18,
      transformRequest: (url, kind) => ({ url, headers: kind === "Tile" ? headers() : {} }),
    });
    this.tiles = new Tiles(this.map);
    this.overlay = new Overlay(this.map);
    this.map.touchZoomRotate.disableRotation();
    this.map.addControl(new maplibre.ScaleControl({ unit: "metric", maxWidth: 160 }), "bottom-left");
    this.map.addControl(new maplibre.NavigationControl({ showCompass: false }), "bottom-right");
    this.map.on("dragstart", () => this.#follow(false));
    this.map.on("moveend", () => this.team && this.#placeLabels());
    this.map.on("resize", () => Object.assign(this, { hasFitted: false }));
    this.map.on("mousemove", ({ point }) => this.#pointAt(point));
    this.map.on("click", ({ point }) => this.#take(point) || this.#copyCursor(point));
    this.pointing = new Pointing(this.map, this.#openMenu.bind(this), this.#pointAt.bind(this), this.#take.bind(this));
    this.menu = new MapMenu(container, () => this.pointing.focus());
    container.append(byId("measured"));
    this.measure = new Measure((marks) => this.overlay.show("measured", marks));
    byId("places").hidden = false;
    copyOnClick(byId("places"));
    this.isLoaded = this.map.once("load");
    this.#buttons();
    selection.changed(() => this.#showSelection());
  }

  /** Show a mission: its plan, a symbol for each vehicle, and a camera that shows them. */
  async start(mission) {
    await this.isLoaded;
    this.mission = mission;
    this.frame = new Frame(mission);
    this.overlay.start(this.frame);
    this.measure.start(mission, this.frame);
    this.tiles.start(mission.tiles);
    for (const { marker } of this.symbols?.values() ?? []) marker.remove();
    for (const { marker } of [...(this.targets ?? []), ...(this.ringNames ?? []), ...(this.traffic?.values() ?? [])]) marker.remove();
    this.traffic = new Map();
    this.symbols = new Map(mission.vehicles.map((planned) => [planned.vehicle_id, this.#vehicle(planned)]));
    this.targets = targetNames(mission).map((name) => this.#marked(targetSymbol(name)));
    this.ringNames = (mission.rings ?? []).map((ring) => this.#marked(ringSymbol(ring)));
    this.showPlan(mission);
    this.fit(this.#planned, 0);
    this.#showSelection();
  }

  /** Draw the fence, the no-fly zones and the starts of a mission. */
  showPlan(mission) {
    this.overlay.show("plan", planMarks(mission));
    for (const { marker } of this.zones ?? []) marker.remove();
    this.zones = (mission.zones ?? []).map((zone) => this.#marked(zoneSymbol(zone)));
    this.zones.forEach(({ marker }, number) => this.#place(marker, zoneMiddle(mission.zones[number])));
  }

  /** The middle of what the map shows, in metres. */
  get middle() {
    const { lng, lat } = this.map.getCenter();
    return this.frame.point_m([lng, lat]);
  }

  /** The width of what the map shows, in metres. */
  get width_m() {
    const [width, height] = this.#size;
    const [from, to] = [0, width].map((x) => this.#pointOf({ x, y: height / 2 }));
    return Math.hypot(to[0] - from[0], to[1] - from[1]);
  }

  /**
   * Put an element at a place in metres.
   * @param {?function(number[], boolean)} moved called with the place, and whether that is the end, while it is dragged
   */
  handle(root, point_m, moved) {
    const marker = new maplibre.Marker({ element: root, draggable: Boolean(moved) });
    marker.setLngLat(this.frame.lonLat(point_m)).addTo(this.map);
    const place = () => {
      const { lng, lat } = marker.getLngLat();
      return this.frame.point_m([lng, lat]);
    };
    if (moved) {
      marker.on("drag", () => moved(place(), false));
      marker.on("dragend", () => moved(place(), true));
    }
    return marker;
  }

  /** Move such an element. */
  move(marker, point_m) {
    marker.setLngLat(this.frame.lonLat(point_m));
  }

  /** Draw a TeamPicture, and the trails from those before it. */
  update(team, past) {
    if (!this.symbols) return;
    this.team = team;
    this.overlay.show("team", teamMarks(this.mission, team));
    this.drawTrails(past);
    for (const vehicle of team.vehicles) this.#showVehicle(vehicle, team);
    this.#showTargets(team);
    this.#showTraffic(team.traffic ?? []);
    this.#placeLabels();
    if (this.isFollowing) this.#keepInView(team);
  }

  /** Show where the vehicles of the station's other teams are. @param {{mission: Object, team: Object}[]} others */
  showOthers(others) {
    this.others ??= new Map();
    const seen = new Set();
    for (const { mission, team } of this.mission ? others : []) {
      if (Boolean(mission.origin_deg) !== Boolean(this.mission.origin_deg)) continue; // their places are not related
      for (const vehicle of team.vehicles.filter((each) => each.position_m)) {
        const key = `${mission.team_number} ${vehicle.vehicle_id}`;
        seen.add(key);
        if (!this.others.has(key)) this.others.set(key, this.#marked(otherSymbol(mission, vehicle.vehicle_id)));
        const { root, marker } = this.others.get(key);
        setText(root, `${mission.mission} ${vehicle.vehicle_id}${vehicle.is_stale ? " (stale)" : ""}`);
        marker.setLngLat(frameOf(mission).lonLat(vehicle.position_m));
        if (!root.isConnected) marker.addTo(this.map);
      }
    }
    for (const [key, { marker }] of this.others) if (!seen.has(key)) marker.remove();
  }

  #showTargets(team) {
    const targets = targetsOf(team);
    this.targets.forEach((symbol, number) => {
      this.#place(symbol.marker, targets[number]?.position_m ?? null);
      if (targets[number]) showTarget(symbol, targets[number]);
    });
    this.ringNames.forEach(({ marker }, number) => {
      const centre = targets[ringsOf(this.mission)[number].target]?.position_m;
      this.#place(marker, centre ? namePlace(this.mission, number, centre, flownRing(this.mission, team, number)[0]) : null);
    });
    const places = targets.map((target) => placeText(this.mission, target?.position_m));
    if (places.length === 1) this.#showPlace("target-place", "Target", places[0]);
    else this.#showPlace("target-place", "Targets", places.map((place, number) => `${this.targets[number].name} ${place}`).join("; "));
  }

  #showTraffic(traffic) {
    for (const [label, { marker }] of this.traffic) {
      if (traffic.some((each) => each.label === label)) continue;
      marker.remove();
      this.traffic.delete(label);
    }
    for (const aircraft of traffic) {
      if (!this.traffic.has(aircraft.label)) this.traffic.set(aircraft.label, this.#marked(trafficSymbol()));
      const symbol = this.traffic.get(aircraft.label);
      showTraffic(symbol, aircraft);
      this.#place(symbol.marker, aircraft.position_m);
    }
  }

  /** Move the camera so that these points are seen. */
  fit(points_m, duration = 300) {
    const bounds = new maplibre.LngLatBounds();
    for (const point_m of points_m) bounds.extend(this.frame.lonLat(point_m));
    if (bounds.isEmpty()) return;
    const bearing = this.map.getBearing();
    this.map.fitBounds(bounds, { padding: PADDING_PX, maxZoom: ZOOM_MAX - 1, bearing, duration: calm() ? 0 : duration });
  }

  /** Apply the page's colours after its theme has changed. */
  recolour() {
    this.tiles.recolour();
  }

  #showPlace(id, name, place) {
    setText(byId(id), `${name} ${place}`);
    setAttribute(byId(id), "data-copied", place);
  }

  #pointOf({ x, y }) {
    const { lng, lat } = this.map.unproject([x, y]);
    return this.frame.point_m([lng, lat]);
  }

  /** Show the place at a pixel, and return it as text. */
  #pointAt(pixel) {
    if (!this.mission) return "";
    const point_m = this.#pointOf(pixel);
    this.measure.move(point_m);
    this.#showPlace("cursor-place", "Cursor", placeText(this.mission, point_m));
    return fullPlaceText(this.mission, point_m);
  }

  #copyCursor(pixel) {
    this.#pointAt(pixel);
    copy(byId("cursor-place").dataset.copied, byId("cursor-place"));
  }

  #take(pixel) {
    return Boolean(this.mission) && this.measure.take(this.#pointOf(pixel));
  }

  #openMenu(pixel, isByKey) {
    if (!this.mission) return;
    const point_m = this.#pointOf(pixel);
    const place = this.#pointAt(pixel);
    const measured = { name: "Measure from here", act: () => this.measure.begin(point_m) };
    const copied = { name: "Copy the place", act: () => this.#copyCursor(pixel) };
    this.menu.open(pixel, place, [...this.choices(point_m, place), measured, copied], isByKey);
  }

  #vehicle(planned) {
    return this.#marked(vehicleSymbol(planned, () => this.selection.toggle(planned.vehicle_id)));
  }

  #marked(symbol) {
    return { ...symbol, marker: new maplibre.Marker({ element: symbol.root, subpixelPositioning: true }) };
  }

  #showVehicle(vehicle, team) {
    const symbol = this.symbols.get(vehicle.vehicle_id);
    if (!symbol) return;
    this.#place(symbol.marker, vehicle.position_m);
    if (vehicle.position_m === null) return;
    const { yaw_rad } = vehicle;
    const rotation_deg = yaw_rad === null ? null : this.frame.bearing_deg(yaw_rad) - this.map.getBearing();
    showVehicle(symbol, vehicle, team, rotation_deg);
  }

  /** Width and height in pixels, found without a new layout of the page. */
  get #size() {
    const { x, y } = this.map.project(this.map.getCenter());
    return [2 * x, 2 * y];
  }

  /** Alarms and the selection have the first choice of places, and are always named; the target has the last. */
  #placeLabels() {
    const shown = byTrouble(this.team).filter((vehicle) => vehicle.position_m && this.symbols.has(vehicle.vehicle_id));
    const isKept = (vehicle) => trouble(vehicle, this.team) === "alarm" || this.selection.has(vehicle.vehicle_id);
    const kept = shown.filter(isKept);
    const vehicles = [...kept, ...shown.filter((vehicle) => !isKept(vehicle))];
    const placed = vehicles.map((vehicle) => ({ ...this.symbols.get(vehicle.vehicle_id), position_m: vehicle.position_m }));
    targetsOf(this.team).forEach((target, number) => target && placed.push({ ...this.targets[number], position_m: target.position_m }));
    const zones = this.map.getContainer().classList.contains(WITHOUT_ZONES) ? [] : this.zones;
    const places = labelPlaces(
      placed.map(({ label, root, position_m }, index) => {
        const { x, y } = this.map.project(this.frame.lonLat(position_m));
        return { x, y, text: label.textContent, place: root.dataset.place, isKept: index < kept.length };
      }),
      this.#size,
      zones.map(({ root, marker }) => ({ ...this.map.project(marker.getLngLat()), text: root.textContent })),
    );
    placed.forEach(({ root }, index) => setAttribute(root, "data-place", places[index]));
  }

  #place(marker, position_m) {
    if (position_m === null) marker.remove();
    else {
      marker.setLngLat(this.frame.lonLat(position_m));
      if (!marker.getElement().isConnected) marker.addTo(this.map);
    }
  }

  /** The starts; in the editor of a mission its fence and zones as well. */
  get #planned() {
    const { vehicles, zones, source } = this.mission;
    const starts = vehicles.map((planned) => planned.start_m);
    return source === "plan" ? [...starts, ...vehicles.flatMap((planned) => planned.fence_m), ...zones.flatMap(zoneLine)] : starts;
  }

  #everything() {
    const seen = this.team ? this.team.vehicles.map((each) => each.position_m).filter(Boolean) : [];
    const points = seen.length ? seen : this.#planned;
    const targets = this.team ? targetsOf(this.team) : [];
    const rings = ringsOf(this.mission).map((ring, number) => [targets[ring.target], flownRing(this.mission, this.team, number)[0]]);
    return [...points, ...rings.flatMap(([target, radius]) => (target ? around(target.position_m, radius) : []))];
  }

  #keepInView(team) {
    const [width, height] = this.#size;
    const points = team.vehicles.map((vehicle) => vehicle.position_m).filter(Boolean);
    const isInside = ({ x, y }) => x > 40 && y > 40 && x < width - 40 && y < height - 40;
    const isSeen = points.every((point_m) => isInside(this.map.project(this.frame.lonLat(point_m))));
    if (this.hasFitted && isSeen) return;
    if (this.hasFitted && this.map.isMoving()) {
      this.isMoved ??= this.map.once("moveend").then(() => this.#moved()); // a replay may show no other picture
      return;
    }
    this.hasFitted = points.length > 0;
    this.fit(this.#everything());
  }

  #moved() {
    this.isMoved = null;
    if (this.isFollowing) this.#keepInView(this.team);
  }

  #follow(isFollowing) {
    this.isFollowing = isFollowing;
    this.hasFitted = false;
    byId("follow").setAttribute("aria-pressed", String(isFollowing));
  }

  #buttons() {
    byId("fit").addEventListener("click", () => this.frame && this.fit(this.#everything()));
    byId("follow").addEventListener("click", () => this.#follow(!this.isFollowing));
    byId("mission-up").addEventListener("click", () => this.#turn());
    for (const box of byId("layers").querySelectorAll("input")) {
      box.addEventListener("change", () => this.#switch(box.value, box.checked));
    }
  }

  #turn() {
    const isNorthUp = this.map.getBearing() !== 0 || !this.frame;
    this.map.setBearing(isNorthUp ? 0 : this.frame.x_bearing_deg);
    byId("mission-up").setAttribute("aria-pressed", String(!isNorthUp));
    for (const vehicle of this.team?.vehicles ?? []) this.#showVehicle(vehicle, this.team);
  }

  #switch(layer, isShown) {
    this.overlay.turn(layer, isShown);
    if (layer === "zones") this.map.getContainer().classList.toggle(WITHOUT_ZONES, !isShown);
    if (layer === "labels") this.map.getContainer().classList.toggle("without-labels", !isShown);
  }

  #showSelection() {
    for (const [id, { root }] of this.symbols ?? []) {
      root.classList.toggle("selected", this.selection.has(id));
    }
  }
}

const around = ([x, y], radius) => [[x - radius, y - radius], [x + radius, y + radius]];

const calm = () => matchMedia("(prefers-reduced-motion: reduce)").matches;
