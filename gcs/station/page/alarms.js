/** Alarms: a sound, a sign and a word until they are acknowledged; removed when they are over and acknowledged. */

import { byId, element, setText } from "./dom.js";
import { capital, vehicleNames } from "./units.js";
import { byTrouble, due, trouble } from "./vehicles.js";

const SOUND_EVERY_MS = 2000;
const TONES_HZ = [880, 660];
const TONE_S = 0.18;
const VIBRATION_MS = [200, 100, 200];
export const STATION_LOST = "No connection to the station";

export class Alarms {
  /** @param {HTMLElement} list of alarms @param {Sound} sound @param {Voice} voice @param {HTMLElement} live an assertive live region */
  constructor(list, sound, voice, live) {
    this.list = list;
    this.sound = sound;
    this.voice = voice;
    this.live = live;
    this.alarms = new Map();
    byId("acknowledge").addEventListener("click", () => this.acknowledge());
    setInterval(() => this.#ring(), SOUND_EVERY_MS);
  }

  start(mission) {
    this.mission = mission.mission;
    this.alarms.clear();
    this.#show();
  }

  /** Update from a team and from whether the station answers. */
  update(team, isConnected) {
    const vehicles = team ? byTrouble(team).filter((vehicle) => trouble(vehicle, team) === "alarm") : [];
    // Of a flight that is lost as a whole, one alarm says more than one for each vehicle.
    const present = vehicles.filter((vehicle) => !(team.lost && vehicle.is_unaccounted)).map(ofVehicle);
    if (team?.lost) present.unshift(ofFlight(team));
    if (!isConnected) present.push({ key: "station", subject: "station", text: STATION_LOST, advice: "Use the terminal or the transmitter." });
    if (this.#take(present)) this.#show();
  }

  /** Remove alarms that are over: a replay may jump in time. */
  removeOver() {
    const over = [...this.alarms].filter(([, alarm]) => !alarm.isPresent);
    for (const [key] of over) this.alarms.delete(key);
    if (over.length) this.#show();
  }

  acknowledge() {
    for (const alarm of this.alarms.values()) alarm.isSeen = true;
    this.#removeOld();
    this.#show();
  }

  /** Return whether anything changed. */
  #take(present) {
    const before = this.#state();
    const news = present.filter((alarm) => !this.alarms.get(alarm.key)?.isPresent);
    this.#endAllBut(present);
    for (const alarm of present) {
      const isSeen = news.includes(alarm) ? false : this.alarms.get(alarm.key).isSeen;
      this.alarms.set(alarm.key, { ...alarm, isPresent: true, isSeen });
    }
    this.#removeOld();
    if (news.length) this.#announce(news);
    return this.#state() !== before;
  }

  /** A vehicle shows only its gravest alert: one that another replaced may still be present, so it is removed, not "over". */
  #endAllBut(present) {
    const keys = new Set(present.map((alarm) => alarm.key));
    const subjects = new Set(present.flatMap((alarm) => alarm.covers ?? [alarm.subject]));
    for (const [key, alarm] of this.alarms) {
      const isReplaced = alarm.isPresent && !keys.has(key) && subjects.has(alarm.subject);
      if (isReplaced) this.alarms.delete(key);
      else alarm.isPresent = false;
    }
  }

  #state() {
    return [...this.alarms.values()].map((alarm) => `${alarm.key}${alarm.isPresent}${alarm.advice}${alarm.due}`).join();
  }

  #removeOld() {
    for (const [key, alarm] of this.alarms) if (alarm.isSeen && !alarm.isPresent) this.alarms.delete(key);
  }

  #announce(news) {
    const said = grouped(news).map((group) => `Alarm. ${words(group)}. ${group[0].advice}`).join(" ");
    setText(this.live, said);
    this.voice.say(said);
    this.sound.play();
  }

  /** Name the alarm, or their number, in the title of the browser's tab, which is seen from another one. */
  #title(present) {
    const alarm = present.length === 1 ? `■ ${words(present)} · ` : present.length ? `■ ${present.length} alarms · ` : "";
    document.title = `${alarm}${this.mission ?? ""} - cordon`;
  }

  #ring() {
    if ([...this.alarms.values()].some((alarm) => alarm.isPresent && !alarm.isSeen)) this.sound.play();
  }

  #show() {
    const alarms = [...this.alarms.values()].toSorted((a, b) => rank(a) - rank(b));
    this.list.parentElement.hidden = alarms.length === 0;
    byId("acknowledge").hidden = alarms.every((alarm) => alarm.isSeen);
    this.#title(alarms.filter((alarm) => alarm.isPresent));
    this.list.replaceChildren(...grouped(alarms).map(row));
  }
}

/** New alarms first, then acknowledged ones, then those that are over; of each, what waits for the operator first. */
const rank = (alarm) => (alarm.isPresent ? Number(alarm.isSeen) : 2) - (alarm.waits ? 0.5 : 0);

function ofVehicle(vehicle) {
  const { vehicle_id, alert, advice, waits_for_resume } = vehicle;
  const key = `${vehicle_id} ${alert}`;
  const cause = vehicle.is_unaccounted ? key : alert; // each one has its own last place
  return { key, cause, subject: vehicle_id, alert, advice, due: due(vehicle), waits: waits_for_resume };
}

/** Alarms in groups, in their order: vehicles with the same alert, as alike seen and over, have one cause, and one row. */
function grouped(alarms) {
  const groups = new Map();
  for (const alarm of alarms) {
    const cause = `${alarm.cause ?? alarm.key} ${alarm.isPresent} ${alarm.isSeen}`;
    groups.set(cause, [...(groups.get(cause) ?? []), alarm]);
  }
  return [...groups.values()];
}

function words(group) {
  const [{ text, alert }] = group;
  if (text) return text;
  const ids = group.map(({ subject }) => subject).toSorted((a, b) => a - b);
  return `Vehicle${ids.length > 1 ? "s" : ""} ${ids.join(", ")}: ${alert}`;
}

function ofFlight({ lost, vehicles }) {
  const names = vehicleNames(lost.vehicles, vehicles);
  return { key: "lost", subject: "flight", covers: lost.vehicles, text: `${capital(names)}: unaccounted for`, advice: "" };
}

function row(group) {
  const [alarm] = group;
  const word = alarm.isPresent ? "ALARM" : "OVER";
  const parts = [element("strong", {}, `${alarm.isPresent ? "■" : "□"} ${word}`), ` ${words(group)}. `];
  if (alarm.isPresent && alarm.due) parts.push(`${alarm.due}. `);
  if (alarm.isPresent && alarm.advice) parts.push(element("em", {}, alarm.advice));
  if (alarm.isSeen) parts.push(" (acknowledged)");
  return element("li", { "data-state": alarm.isPresent ? (alarm.isSeen ? "seen" : "new") : "over" }, ...parts);
}

/** Two tones. Browsers allow sound only after a gesture: until then, and when the system takes it away, the switch shows it. */
export class Sound {
  #context = null;
  #isOn = true;

  /** @param {HTMLButtonElement} button */
  constructor(button) {
    this.button = button;
    button.addEventListener("click", () => (this.#isLocked ? this.#unlock() : this.turn(!this.#isOn)));
    // A press of the button itself does what the button said when it was pressed.
    const unlock = (event) => this.#isLocked && !button.contains(event.target) && this.#unlock();
    for (const gesture of ["pointerdown", "pointerup", "keydown"]) document.addEventListener(gesture, unlock, { capture: true });
    this.#show();
  }

  /** Vibrate and sound, as far as the device can and the switch is on. */
  play() {
    if (!this.#isOn) return;
    if (navigator.userActivation?.hasBeenActive) navigator.vibrate?.(VIBRATION_MS);
    if (this.#context?.state !== "running") return;
    TONES_HZ.forEach((tone_hz, index) => this.#tone(tone_hz, this.#context.currentTime + index * TONE_S));
  }

  #tone(tone_hz, from_s) {
    const oscillator = new OscillatorNode(this.#context, { type: "square", frequency: tone_hz });
    const gain = new GainNode(this.#context, { gain: 0.25 });
    oscillator.connect(gain).connect(this.#context.destination);
    oscillator.start(from_s);
    oscillator.stop(from_s + TONE_S);
  }

  get #isLocked() {
    return this.#isOn && this.#context?.state !== "running";
  }

  #unlock() {
    if (!this.#context) {
      this.#context = new AudioContext();
      this.#context.addEventListener("statechange", () => this.#show());
    }
    this.#context.resume().then(() => this.#show());
  }

  turn(isOn) {
    this.#isOn = isOn;
    this.#show();
  }

  #show() {
    this.button.setAttribute("aria-pressed", String(this.#isOn));
    setText(this.button, this.#isLocked ? "Sound: press once" : `Sound ${this.#isOn ? "on" : "off"}`);
  }
}
