/** The editor of a mission's fence and no-fly zones: corners on the map, by mouse, finger and keyboard; names and heights beside it. */

import { byId, element, setText } from "./dom.js";
import { fullPlaceText } from "./places.js";

const CHECK_AFTER_MS = 300;
const SHARE = 1 / 12; // of the map's width: half of a new zone
const STEP_M = 1;
const STRIDE_M = 10;
const CORNERS_MIN = 3;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

const rounded = (value) => Math.round(value * 10) / 10;

const square = ([x, y], half) => [[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]].map((corner) => corner.map(rounded));

export class PlanEditor {
  /** @param {Scene} scene that has begun @param {Object} mission @param {Object} plan a PlanPicture @param {function(Object): boolean} send */
  constructor(scene, mission, plan, send) {
    Object.assign(this, { scene, mission, send, requests: 0, handles: [] });
    this.original = JSON.stringify(plan.fence_m);
    this.areas = [...(plan.fence_m.length ? [fence(plan.fence_m)] : []), ...plan.zones.map((zone) => ({ ...zone }))];
    setText(byId("editor-file"), `Mission file: ${plan.file}`);
    byId("editor").hidden = false;
    byId("add-zone").addEventListener("click", () => this.#add(this.zoneAt(scene.middle)));
    byId("add-circle").addEventListener("click", () => this.#add(this.circleAt(scene.middle)));
    byId("add-fence").addEventListener("click", () => this.#add(fence(square(scene.middle, 4 * this.#half))));
    byId("save-plan").addEventListener("click", () => this.#ask(true));
    addEventListener("beforeunload", (event) => this.isChanged && event.preventDefault());
    this.#rebuild();
    this.#ask(false);
  }

  /** What the map's menu offers at a place. */
  choices(point_m) {
    return [
      { name: "No-fly zone here", act: () => this.#add(this.zoneAt(point_m)) },
      { name: "Circular no-fly zone here", act: () => this.#add(this.circleAt(point_m)) },
    ];
  }

  zoneAt(point_m) {
    return { name: this.#newName(), polygon_m: square(point_m, this.#half), center_m: null, radius_m: null, floor_m: null, ceiling_m: null };
  }

  circleAt(point_m) {
    return { ...this.zoneAt(point_m), polygon_m: [], center_m: point_m.map(rounded), radius_m: this.#half };
  }

  /** Take a PlanAnswer. */
  answer({ request, faults, is_saved }) {
    if (request !== this.requests) return;
    byId("editor-faults").replaceChildren(...faults.map((fault) => element("li", {}, `■ ${fault}`)));
    if (is_saved) this.isChanged = false;
    setText(byId("editor-state"), faults.length ? "not saved: it has faults" : is_saved ? "✓ saved" : this.isChanged ? "valid, not saved" : "as saved");
  }

  get #half() {
    return Math.max(1, Math.round(this.scene.width_m * SHARE));
  }

  #newName() {
    const names = this.areas.map(({ name }) => name);
    for (let number = 1; ; number += 1) if (!names.includes(`zone-${number}`)) return `zone-${number}`;
  }

  #add(area) {
    this.areas.push(area);
    this.#changed();
    this.#rebuild();
    byId("editor-areas").lastElementChild.querySelector("input, button").focus();
  }

  #remove(area) {
    this.areas.splice(this.areas.indexOf(area), 1);
    this.#changed();
    this.#rebuild();
    byId("add-zone").focus();
  }

  #changed() {
    this.isChanged = true;
    setText(byId("editor-state"), "checking");
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.#ask(false), CHECK_AFTER_MS);
    this.#draw();
  }

  #ask(save) {
    clearTimeout(this.timer);
    this.requests += 1;
    const [fence_m, zones] = [this.areas.find((area) => area.isFence)?.polygon_m ?? [], this.areas.filter((area) => !area.isFence)];
    const isSent = this.send({ kind: "plan", request: this.requests, fence_m, zones, save });
    if (!isSent) setText(byId("editor-state"), "no connection to the station: nothing is saved");
  }

  #draw() {
    const fence_m = this.areas.find((area) => area.isFence)?.polygon_m ?? [];
    const vehicles = this.mission.vehicles.map((each) => (JSON.stringify(each.fence_m) === this.original ? { ...each, fence_m } : each));
    this.scene.showPlan({ ...this.mission, vehicles, zones: this.areas.filter((area) => !area.isFence) });
  }

  #rebuild() {
    this.#draw();
    byId("add-fence").disabled = this.areas.some((area) => area.isFence);
    byId("editor-areas").replaceChildren(...this.areas.map((area) => this.#row(area)));
    this.#remakeHandles();
  }

  #remakeHandles() {
    for (const handle of this.handles) handle.remove();
    this.handles = this.areas.flatMap((area) => (area.radius_m === null ? this.#corners(area) : [this.#centre(area)]));
  }

  #row(area) {
    const parts = area.isFence ? [element("strong", {}, "Fence")] : [this.#name(area), ...(area.radius_m === null ? [] : [this.#number(area, "radius_m", "Radius")]), this.#number(area, "floor_m", "From"), this.#number(area, "ceiling_m", "To")];
    const remove = element("button", { type: "button", "aria-label": `Remove ${area.isFence ? "the fence" : area.name}` }, "Remove");
    remove.addEventListener("click", () => this.#remove(area));
    return element("li", {}, ...parts, remove);
  }

  #name(area) {
    const input = element("input", { type: "text", value: area.name, maxlength: "24", "aria-label": "Name of the zone" });
    input.addEventListener("input", () => this.#set(area, "name", input.value));
    return input;
  }

  #number(area, key, title) {
    const input = element("input", { type: "number", step: "0.5", value: area[key] ?? "", placeholder: "–" });
    input.addEventListener("input", () => this.#set(area, key, input.value === "" ? null : Number(input.value)));
    return element("label", {}, `${title}, m `, input);
  }

  /** A circle keeps its last radius while its field is empty. */
  #set(area, key, value) {
    if (key === "radius_m" && !(value > 0)) return;
    area[key] = value;
    this.#changed();
    if (key === "name") this.#remakeHandles();
  }

  #corners(area) {
    const { polygon_m: corners } = area;
    const places = corners.map((corner, index) => this.#handle(area, `Corner ${index + 1}`, corner, (moved) => (corners[index] = moved), (key) => this.#edit(area, index, key)));
    return [...places, ...corners.map((_, index) => this.#between(area, index))];
  }

  #centre(area) {
    return this.#handle(area, "Centre", area.center_m, (moved) => (area.center_m = moved), () => false);
  }

  /** Delete removes a corner, Insert adds one after it. Return whether the key was one of these. */
  #edit(area, index, key) {
    if (key === "Delete" && area.polygon_m.length > CORNERS_MIN) area.polygon_m.splice(index, 1);
    else if (key === "Insert") area.polygon_m.splice(index + 1, 0, middle(area.polygon_m, index));
    else return false;
    this.#changed();
    this.#rebuild();
    return true;
  }

  #handle(area, what, place, move, edit) {
    const name = () => setLabel(root, `${what} of ${area.isFence ? "the fence" : area.name} at ${fullPlaceText(this.mission, place)}`);
    const root = element("button", { type: "button", class: "handle" });
    const handle = this.scene.handle(root, place, (moved, isOver) => {
      place = moved.map(rounded);
      move(place);
      this.#changed();
      name();
      if (isOver) this.#rebuild();
    });
    root.addEventListener("keydown", (event) => {
      if (edit(event.key)) event.preventDefault();
      const [x, y] = ARROWS[event.key] ?? [0, 0];
      if (!x && !y) return;
      event.preventDefault();
      event.stopPropagation();
      const step = event.shiftKey ? STRIDE_M : STEP_M;
      place = [place[0] + step * x, place[1] + step * y].map(rounded);
      move(place);
      this.scene.move(handle, place);
      this.#changed();
      name();
    });
    name();
    return handle;
  }

  /** A mark between two corners: a press adds a corner there. */
  #between(area, index) {
    const place = middle(area.polygon_m, index);
    const root = element("button", { type: "button", class: "handle between", tabindex: "-1", "aria-label": `Add a corner after corner ${index + 1}` }, "+");
    root.addEventListener("click", () => this.#edit(area, index, "Insert"));
    return this.scene.handle(root, place, null);
  }
}

const fence = (polygon_m) => ({ isFence: true, name: "fence", polygon_m: polygon_m.map((corner) => [...corner]), radius_m: null });

function middle(corners, index) {
  const [x, y] = corners[index];
  const [to_x, to_y] = corners[(index + 1) % corners.length];
  return [(x + to_x) / 2, (y + to_y) / 2].map(rounded);
}

const setLabel = (node, text) => node.setAttribute("aria-label", text);
