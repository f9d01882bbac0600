/** The operator's page: a live team or a recorded flight, drawn by the same parts. */

import { Alarms, Sound } from "./alarms.js";
import { Cards } from "./cards.js";
import { Checklist } from "./checklist.js";
import { Commands } from "./commands.js";
import { byId, setText } from "./dom.js";
import { Events } from "./events.js";
import { Replay } from "./replay.js";
import { Selection } from "./selection.js";
import { Stream, streamUrl } from "./stream.js";
import { Strips } from "./strips.js";
import { Table } from "./table.js";
import { Tabs } from "./tabs.js";
import { startTheme } from "./theme.js";
import { TopBar } from "./topbar.js";
import { agedTeam } from "./vehicles.js";
import { Voice } from "./voice.js";
import { WakeLock } from "./wake_lock.js";

const PAST_S = 120;
const PAST_EVERY_S = 0.5;
const SILENCE_MAX_S = 2;
const CHECK_EVERY_MS = 250;

/** The parts of the page, updated with pictures: `start` with a mission, `show` with a team and its past. */
class Page {
  /** @param {function(Object): boolean} send passes a request to the station @param {function(): Object} headers of requests for tiles */
  constructor(send, headers) {
    this.headers = headers;
    this.selection = new Selection();
    this.commands = new Commands(this.selection, send);
    this.events = new Events(byId("events"), byId("polite"));
    this.alarms = new Alarms(byId("alarms"), new Sound(byId("sound")), new Voice(byId("voice")), byId("assertive"));
    this.topbar = new TopBar();
    this.strips = new Strips(byId("strips"));
    this.cards = new Cards(byId("cards"), this.selection, send);
    this.checklist = new Checklist(send);
    this.table = new Table(byId("table"));
    this.scene = null;
    this.tabs = new Tabs(byId("views"), () => this.redraw());
    startTheme(byId("theme"), () => this.#recolour());
    this.#openScene();
  }

  start(mission) {
    const isSame = isSamePlan(mission, this.mission);
    this.mission = mission;
    if (isSame) {
      this.topbar.start(mission);
      this.commands.start(mission);
      return;
    }
    this.team = null;
    this.selection.start(mission.vehicles.map(({ vehicle_id }) => vehicle_id));
    const { topbar, commands, alarms, strips, cards, table } = this;
    for (const part of [topbar, commands, alarms, strips, cards, table]) part.start(mission);
    this.scene?.start(mission).then(() => this.redraw());
    document.body.dataset.source = mission.source;
  }

  /** Draw a team. @param {Object[]} past TeamPictures up to it, in the order of time */
  show(team, past, isConnected) {
    Object.assign(this, { team, past });
    this.topbar.update(team, isConnected);
    this.commands.update(team);
    this.cards.update(team);
    this.checklist.update(team);
    this.redraw();
  }

  redraw() {
    if (!this.team) return;
    this.strips.update(this.past);
    if (!byId("table-panel").hidden) this.table.update(this.team);
    if (!byId("map-panel").hidden) this.scene?.update(this.team, this.past);
  }

  async #openScene() {
    if (!document.createElement("canvas").getContext("webgl2")) {
      byId("no-webgl").hidden = false;
      byId("map-tools").hidden = true;
      this.tabs.show(byId("table-tab"));
      return;
    }
    byId("map-state").hidden = false;
    try {
      const { Scene } = await import("./scene.js");
      this.scene = new Scene(byId("map"), this.selection, this.headers, (...place) => this.commands.choices(...place));
      await this.scene.isLoaded;
    } catch (error) {
      setText(byId("map-state"), "The map could not be loaded: reload the page. The cards and the table show every quantity.");
      throw error;
    }
    byId("map-state").hidden = true;
    if (this.mission) this.scene.start(this.mission).then(() => this.redraw());
  }

  #recolour() {
    this.scene?.recolour();
    this.strips.recolour();
    this.redraw();
  }
}

/** Whether a mission equals the one shown, apart from its operator. */
function isSamePlan(mission, shown) {
  const plan = (each) => JSON.stringify({ ...each, operator: null });
  return Boolean(shown) && plan(mission) === plan(shown);
}

/** A team in flight: each picture is drawn in the next frame, and becomes stale without a new one. */
class Live {
  /** @param {Stream} stream that the page has entered */
  constructor(stream) {
    this.team = null;
    this.past = [];
    this.arrived_ms = performance.now();
    this.wakeLock = new WakeLock();
    this.page = new Page((request) => stream.send(request), () => stream.entry.headers);
    this.connection(true);
    setInterval(() => this.#check(), CHECK_EVERY_MS);
  }

  /** Take a picture of the station. */
  take(picture) {
    if (picture.kind === "mission") this.#start(picture);
    else if (picture.kind === "event") this.page.events.add(picture);
    else if (picture.kind === "receipt") this.page.commands.receipt(picture);
    else if (picture.kind === "checklist") this.page.checklist.take(picture);
    else if (picture.kind === "answer") this.page.commands.answer(picture);
    else if (picture.kind === "team" && this.page.mission) this.#team(picture); // one that overtook the mission has a successor
  }

  #start(mission) {
    if (!isSamePlan(mission, this.page.mission)) Object.assign(this, { team: null, past: [] });
    this.page.start(mission);
  }

  #team(team) {
    this.team = team;
    this.arrived_ms = performance.now();
    const last = this.past.at(-1);
    if (last && (team.time_s ?? 0) < (last.time_s ?? 0)) this.past = []; // another flight has begun
    if (!last || (team.time_s ?? 0) - (last.time_s ?? 0) >= PAST_EVERY_S) this.past.push(team);
    while (this.past.length > PAST_S / PAST_EVERY_S) this.past.shift();
    this.wakeLock.want(!team.ending);
    this.#warn();
    this.frame ??= requestAnimationFrame(() => this.#draw());
  }

  /** Take that the connection has begun or ended. */
  connection(isOpen) {
    this.isOpen = isOpen;
    if (isOpen) this.page.events.start(); // the station sends past events again
    else this.page.commands.connectionLost();
    this.#check();
  }

  get #silence_s() {
    return (performance.now() - this.arrived_ms) / 1000;
  }

  get #isConnected() {
    return this.isOpen && (this.team === null || this.#silence_s < SILENCE_MAX_S);
  }

  #aged() {
    return this.team && agedTeam(this.team, this.#silence_s);
  }

  #warn() {
    this.page.alarms.update(this.#aged(), this.#isConnected || Boolean(this.team?.ending));
  }

  #check() {
    this.#warn();
    if (!this.team) this.page.topbar.update(null, this.#isConnected);
    else if (this.#silence_s > CHECK_EVERY_MS / 1000) this.frame ??= requestAnimationFrame(() => this.#draw());
  }

  #draw() {
    this.frame = null;
    if (this.team) this.page.show(this.#aged(), this.past, this.#isConnected);
  }
}

/** Show a recorded flight on the same page: the time slider chooses the picture. */
function showFlight(flight, headers = () => ({})) {
  const page = new Page(() => false, headers);
  page.start(flight.mission);
  page.alarms.sound.turn(false);
  new Replay(flight, (index) => {
    const team = flight.teams[index];
    page.show(team, pastOf(flight.teams, index), true);
    page.alarms.update(team, true);
    page.alarms.removeOver();
    page.events.showUntil(flight.events, team.time_s ?? 0);
  });
}

function pastOf(teams, index) {
  const from_s = (teams[index].time_s ?? 0) - PAST_S;
  const first = teams.findIndex((team) => (team.time_s ?? 0) >= from_s);
  return teams.slice(first, index + 1);
}

/** Open the page of a station: a recorded flight if the station says so, else a live team. */
function openStation(flightUrl) {
  let live = null;
  let flight = null;
  const picture = async (shown) => {
    if (shown.kind !== "recorded") (live ??= new Live(stream)).take(shown);
    else if (!flight) {
      const fetched = await stream.fetch(flightUrl);
      if (!fetched || flight) return; // after a connection that ended meanwhile, two requests are on their way
      flight = fetched;
      showFlight(flight, () => stream.entry.headers);
    }
  };
  const stream = new Stream(streamUrl(), { picture, connection: (isOpen) => live?.connection(isOpen) });
}

const flightUrl = byId("flight").href;
if (flightUrl.startsWith("blob:")) showFlight(await (await fetch(flightUrl)).json()); // in a report
else openStation(flightUrl);
