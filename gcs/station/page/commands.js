/** Commands to one, some or all vehicles: their confirmations and their answers. */

import { byId, element, setText } from "./dom.js";
import { actWhenHeld, ignoreKeyRepeat } from "./hold_button.js";
import { PlacePrompt } from "./place_prompt.js";
import { AssignPrompt, KillPrompt, PilotPrompt, RingPrompt } from "./prompts.js";
import { flownRing, ringsOf } from "./rings.js";
import { age, vehicleNames } from "./units.js";

const REQUESTS_MAX = 20;
const DELIVERED_WITHIN_MS = 1500;
const PILOT = "pilot override";
const NOT_SENT = "No connection to the station: press again once it is restored.";
const GOTO = "goto";
const LOOK = "look";
const ALL = 0; // no vehicle has this id
const HOLD = { verb: "hold", key: "h" };

export class Commands {
  /** @param {Selection} selection @param {function(Object): boolean} send passes a request to the station */
  constructor(selection, send) {
    this.selection = selection;
    this.send = send;
    this.team = null;
    this.requests = new Map();
    this.kill = new KillPrompt((verb, target, word) => this.#request(verb, target, { confirmation: word }));
    this.pilot = new PilotPrompt((verb, target, overrides) => this.#request(verb, target, { overrides_pilot: overrides }));
    this.ring = new RingPrompt((verb, target, ring) => this.#request(verb, target, ring));
    this.assign = new AssignPrompt((verb, target, ring) => this.#request(verb, { ...target, isAll: false }, ring));
    this.place = new PlacePrompt();
    selection.changed(() => this.#showTarget());
    byId("select-all").addEventListener("click", () => selection.clear());
    byId("hold-all").addEventListener("click", () => this.#hold(this.#everyone()));
    // What a button says does not change while it is pressed.
    for (const press of ["pointerdown", "keydown"]) byId("verbs").addEventListener(press, () => selection.keep());
    document.addEventListener("keydown", (event) => this.#key(event));
    ignoreKeyRepeat(document);
  }

  /** Show the commands that the operator of a mission may give. */
  start(mission) {
    this.mission = mission;
    const isOffered = ({ name, button, takes }) => button && mission.operator.may.includes(name) && (takes !== "assign" || mission.rings);
    const offered = mission.verbs.filter(isOffered);
    const names = offered.map(({ name }) => name).join();
    offered.sort((first, second) => first.button - second.button);
    if (names !== this.offered) byId("verbs").replaceChildren(...offered.map((verb) => this.#button(verb)));
    this.offered = names;
    byId("commands").hidden = mission.source === "log";
    this.readOnly = mission.operator.read_only;
    this.#showReadOnly();
    byId("target").hidden = byId("answers").hidden = offered.length === 0;
    this.hold = offered.find(({ name }) => name === HOLD.verb);
    byId("hold-all").hidden = !this.hold;
    this.#showTarget();
  }

  /** What can be sent about a place, in metres and as text, for the map's menu. */
  choices(point_m, place) {
    if (this.mission.source === "log") return [];
    const why = this.mission.operator.sights ? "" : "no sensor's keys here";
    const target = { name: "The target is here…", why, act: () => this.#askTarget(point_m, place) };
    const none = this.#processesEnded || !this.selection.all.length ? "no vehicle flies" : "";
    const choice = (verb, name, act) => ({ name: `${name}…`, why: this.#granted(verb) ? none : `may not ${verb}`, act: () => act(this.#granted(verb), name) });
    const goto = (name, lands) => choice(GOTO, name, (verb) => this.#askGoto(verb, name, point_m, place, lands));
    const look = (name, at_m, where) => choice(LOOK, name, (verb) => this.#askLook(verb, name, at_m, where));
    const looks = [look("Look here", point_m, place), look("Look at the target again", null, "the target")];
    return [target, goto("Hold there", false), goto("Land there", true), ...(this.#withGimbal.length ? looks : [])];
  }

  /** A verb that this operator may command, undefined without the right. */
  #granted(verb) {
    return this.mission.verbs.find(({ name }) => name === verb && this.mission.operator.may.includes(verb));
  }

  /** The vehicles that are commanded whose cameras can be pointed. */
  get #withGimbal() {
    const pointed = this.mission.vehicles.filter(({ has_gimbal }) => has_gimbal).map(({ vehicle_id }) => vehicle_id);
    return pointed.filter((id) => this.selection.all.includes(id));
  }

  /** Ask whose camera looks at a place, or at the target (`at_m` null): that of the only vehicle selected, or all. */
  #askLook(verb, title, at_m, where) {
    const pointed = this.#withGimbal;
    const { vehicles, all } = this.selection;
    const chosen = vehicles.length === 1 && pointed.includes(vehicles[0]) ? vehicles[0] : ALL;
    this.place.askVehicle(title, where, [[ALL, "all cameras"], ...named(pointed)], chosen, ({ vehicle }) => {
      const to = { vehicles: vehicle === ALL ? pointed : [vehicle], all, isAll: false };
      this.#request({ ...verb, label: `look at ${where}` }, to, { place: at_m && [...at_m, false] });
    });
  }

  /** Ask which vehicle goes to a place: the selected one, or the nearest. */
  #askGoto(verb, title, point_m, place, lands) {
    const { vehicles, all } = this.selection;
    const away = (id) => {
      const at = this.team?.vehicles.find((each) => each.vehicle_id === id)?.position_m;
      return at ? Math.hypot(at[0] - point_m[0], at[1] - point_m[1]) : Infinity;
    };
    const [nearest] = vehicles.toSorted((one, other) => away(one) - away(other));
    this.place.askVehicle(title, place, named(all), nearest, ({ vehicle }) => {
      this.#request({ ...verb, label: `${lands ? "land" : "hold"} at ${place}` }, { vehicles: [vehicle], all, isAll: false }, { place: [...point_m, lands] });
    });
  }

  #askTarget(position_m, place) {
    this.place.askTarget(place, this.mission.targets ?? [], ({ sigma_m, lasting_s, target }) => {
      const id = requestName();
      const isSent = this.send({ kind: "sighting", request: id, position_m, sigma_m, lasting_s, target });
      this.#add({ label: `target at ${place}` }, null, isSent ? "" : NOT_SENT, id);
    });
  }

  get #processesEnded() {
    return Boolean(this.team?.lost?.processes_ended);
  }

  update(team) {
    const hadEnded = this.#processesEnded;
    this.team = team;
    this.selection.update(team);
    if (this.#processesEnded !== hadEnded) this.#showTarget();
    this.#showReadOnly();
    this.#showRest();
  }

  /** Show that a request has arrived at the station. */
  receipt({ request: id }) {
    const request = this.requests.get(id);
    if (!request) return;
    request.isDelivered = true;
    this.#showRequest(request);
  }

  /** Show an AnswerPicture. */
  answer(answer) {
    const request = this.requests.get(answer.request);
    if (!request) return;
    request.isDelivered = true;
    request.answers.set(answer.vehicle_id, answer);
    this.#showRequest(request);
  }

  /** Requests are not repeated: the outcome of unanswered ones to this team is unknown. */
  connectionLost(team) {
    for (const request of this.requests.values()) {
      if (request.team !== team) continue;
      request.isLost = true;
      this.#showRequest(request);
    }
  }

  #showReadOnly() {
    byId("read-only").hidden = this.offered !== "";
    const reason = this.readOnly || "there is no operator's key for this page";
    setText(byId("read-only"), this.team?.ending || this.team?.lost ? "Flight over: cordon flies no vehicle." : `Read-only: ${reason}.`);
  }

  #button(verb) {
    const isHeld = verb.confirmation === "all" || verb.confirmation === "take-off";
    const name = element("span", { class: "verb" }, `${title(verb)}${verb.confirmation === "word" || verb.takes ? "…" : ""}`);
    const button = element("button", { type: "button", "data-verb": verb.name, "data-takes": verb.takes, "data-landed": verb.is_for_landed ? "yes" : "", class: isHeld ? "held" : "" }, name);
    if (isHeld) actWhenHeld(button, () => this.#request(verb, verb.is_for_landed ? this.#landed() : this.#target(), {}));
    else button.addEventListener("click", () => this.#press(verb));
    button.append(element("span", { class: "whom" }));
    return button;
  }

  #target() {
    const { vehicles, all, isEmpty } = this.selection;
    return { vehicles, all, isAll: isEmpty };
  }

  /** The vehicles that are down, each of which may take off again. */
  #landed() {
    return { vehicles: this.selection.landed, all: this.selection.landed, isAll: false };
  }

  #everyone() {
    const { all } = this.selection;
    return { vehicles: all, all, isAll: true };
  }

  /** Hold at once, as at the terminal also instead of a command that waits for its confirmation. */
  #hold(target) {
    for (const dialog of document.querySelectorAll("dialog[open]")) dialog.close();
    this.#request(this.hold, target, {});
  }

  #key(event) {
    const isChord = event.ctrlKey || event.altKey || event.metaKey;
    if (!this.hold || this.#processesEnded || event.key !== HOLD.key || isChord || event.repeat || byId("commands").hidden) return;
    event.preventDefault();
    this.#hold(this.#target());
  }

  #press(verb) {
    if (verb.takes === "ring") {
      this.ring.ask(verb, this.#everyone(), this.#rings);
      return;
    }
    const target = this.#target();
    if (verb.confirmation !== "at once" && this.selection.hasJustEnded) {
      this.#add(verb, target, "The selection had just ended: press again for all.");
      return;
    }
    const flown = verb.confirmation === "pilots" ? this.#flownByPilots(target.vehicles) : [];
    if (verb.takes) this.assign.ask(verb, target, this.#rings, this.team?.vehicles ?? []);
    else if (verb.confirmation === "word") this.kill.ask(verb, target);
    else if (flown.length) this.pilot.ask(verb, target, flown);
    else this.#request(verb, target, {});
  }

  /** The rings: name, bounds, and radius, rate, altitude and tilt as commanded last, or the mission's. */
  get #rings() {
    return ringsOf(this.mission).map(({ name, ring_bounds: bounds }, number) => ({ name, bounds, ring: flownRing(this.mission, this.team, number) }));
  }

  #flownByPilots(vehicle_ids) {
    const vehicles = this.team?.vehicles ?? [];
    return vehicles.filter((each) => each.tactic === PILOT && vehicle_ids.includes(each.vehicle_id)).map((each) => each.vehicle_id);
  }

  #request(verb, target, confirmations) {
    const vehicles = target.isAll ? null : target.vehicles;
    const id = requestName();
    const isSent = this.send({ kind: "command", request: id, verb: verb.name, vehicles, ...confirmations });
    this.#add(verb, target, isSent ? "" : NOT_SENT, id);
    this.selection.clear();
  }

  /** Show a request, with the vehicles that it is for or null; `unsent` is why it was not sent, empty if it was. */
  #add(verb, target, unsent, id = requestName()) {
    const request = { verb, target, unsent, isLost: false, isDelivered: false, isSlow: false, answers: new Map(), item: element("li", { "data-request": id }) };
    request.team = this.mission.team_number;
    request.to = this.mission.team_count > 1 ? ` (${this.mission.mission})` : "";
    request.sentAt = new Date().toLocaleTimeString([], { hour12: false });
    this.requests.set(id, request);
    byId("answers").prepend(request.item);
    this.#showRequest(request);
    setTimeout(() => this.#slow(request), DELIVERED_WITHIN_MS);
    this.#removeOld();
  }

  #slow(request) {
    if (request.isDelivered) return;
    request.isSlow = true;
    this.#showRequest(request);
  }

  #removeOld() {
    for (const [id, request] of this.requests) {
      if (this.requests.size <= REQUESTS_MAX) return;
      request.item.remove();
      this.requests.delete(id);
    }
  }

  #showRequest(request) {
    const { target } = request;
    const head = `${request.sentAt} ${title(request.verb)}${target ? `, ${vehicleNames(target.vehicles, target.all)}` : ""}${request.to}`;
    const answers = [...request.answers.values()].map(answerRow);
    request.item.replaceChildren(element("strong", {}, head), element("ul", {}, ...answers, ...openRow(request)));
  }

  #showTarget() {
    const { vehicles, all, without, isEmpty } = this.selection;
    const of = this.mission?.team_count > 1 ? ` of ${this.mission.mission}` : "";
    setText(byId("target-text"), `To ${vehicleNames(vehicles, all)}${of}${without && ` (${without})`}`);
    setText(byId("hold-all"), `Hold all ${all.length}`);
    byId("hold-all").disabled = all.length === 0 || this.#processesEnded;
    byId("select-all").hidden = isEmpty;
    this.#showRest();
    for (const button of byId("verbs").children) {
      const how = button.classList.contains("held") ? ", hold 1 s" : button.dataset.verb === HOLD.verb ? `, key ${HOLD.key}` : "";
      const { landed } = this.selection;
      const whom = button.dataset.landed ? landed : button.dataset.takes === "ring" ? all : vehicles; // a ring is the whole team's
      const names = button.dataset.landed ? whom.join(", ") : shortNames(whom, all);
      setText(button.querySelector(".whom"), whom.length ? names + how : "");
      button.disabled = all.length === 0 || whom.length === 0 || this.#processesEnded;
    }
  }

  #showRest() {
    const { isEmpty, rest_s } = this.selection;
    setText(byId("target-rest"), isEmpty ? "" : `for ${Math.ceil(rest_s)} s`);
  }
}

const named = (vehicles) => vehicles.map((id) => [id, `vehicle ${id}`]);

const title = ({ label }) => `${label[0].toUpperCase()}${label.slice(1)}`;

function shortNames(vehicles, all) {
  return vehicles.length === all.length ? `all ${all.length}` : vehicles.join(", ");
}

function answerRow(answer) {
  const who = answer.vehicle_id === null ? "Station" : `Vehicle ${answer.vehicle_id}`;
  const sign = answer.is_obeyed ? "✓" : "✗";
  const after = answer.vehicle_id === null && !answer.is_obeyed ? "" : `, after ${age(answer.after_s)}`;
  const attributes = { "data-obeyed": String(answer.is_obeyed), "data-final": String(answer.is_final) };
  return element("li", attributes, `${answer.is_final ? sign : "…"} ${who}: ${answer.did}${after}`);
}

/** The vehicles that have not answered a request yet. */
function openRow(request) {
  if (request.unsent) return [element("li", {}, `✗ Not sent. ${request.unsent}`)];
  if (request.answers.has(null)) return [];
  const open = request.target?.vehicles.filter((id) => !request.answers.get(id)?.is_final);
  if (open?.length === 0) return [];
  const names = open ? vehicleNames(open, request.target.all) : "the station";
  if (request.isLost) {
    const what = request.isDelivered ? `${names} answered` : "it was delivered to the station";
    return [element("li", {}, `▲ Connection lost before ${what}. Watch the vehicles. The command is not repeated.`)];
  }
  if (request.isSlow && !request.isDelivered) return [element("li", {}, "▲ Not delivered to the station yet: the connection is slow")];
  return [element("li", {}, `… Waiting for ${names}`)];
}

/** A name for a press; `crypto.randomUUID` exists in secure contexts only. */
function requestName() {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}
