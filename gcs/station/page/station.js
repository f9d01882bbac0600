/** The operator's page: a live team or a recorded flight, drawn by the same parts. */

import { Alarms, Sound } from "./alarms.js";
import { Cards } from "./cards.js";
import { Checklist } from "./checklist.js";
import { Commands } from "./commands.js";
import { byId, setText } from "./dom.js";
import { Events } from "./events.js";
import { PlanEditor } from "./plan_editor.js";
import { Replay } from "./replay.js";
import { Selection } from "./selection.js";
import { Stream, streamUrl } from "./stream.js";
import { Strips } from "./strips.js";
import { Table } from "./table.js";
import { Tabs } from "./tabs.js";
import { showTeams } from "./teams.js";
import { startTheme } from "./theme.js";
import { TopBar } from "./topbar.js";
import { agedTeam } from "./vehicles.js";
import { Voice } from "./voice.js";
import { WakeLock } from "./wake_lock.js";

const PAST_S = 120;
const PAST_EVERY_S = 0.5;
const SILENCE_MAX_S = 2;
const CHECK_EVERY_MS = 250;
const EVENTS_KEPT = 500;

/** The parts of the page, updated with pictures: `start` with a mission, `show` with a team and its past. */
class Page {
  /** @param {function(Object): boolean} send passes a request to the station @param {function(): Object} headers of requests for tiles */
  constructor(send, headers) {
    Object.assign(this, { send, headers });
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
    this.scene?.start(mission).then(() => this.#begun());
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
      this.scene = new Scene(byId("map"), this.selection, this.headers, (...place) => this.#choices(...place));
      await this.scene.isLoaded;
    } catch (error) {
      setText(byId("map-state"), "The map could not be loaded: reload the page. The cards and the table show every quantity.");
      throw error;
    }
    byId("map-state").hidden = true;
    if (this.mission) this.scene.start(this.mission).then(() => this.#begun());
  }

  #begun() {
    this.redraw();
    if (this.plan && !this.editor) this.editor = new PlanEditor(this.scene, this.mission, this.plan, this.send);
  }

  /** Edit the fence and the zones of a PlanPicture; what has been changed on the page stays after a broken connection. */
  edit(plan) {
    this.plan = plan;
    if (this.scene?.zones) this.#begun();
  }

  #choices(point_m, place) {
    return this.editor ? this.editor.choices(point_m) : this.commands.choices(point_m, place);
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
  /** @param {Stream} stream that the page has entered, or will @param {Teams} teams that it is one of */
  constructor(stream, teams) {
    Object.assign(this, { stream, teams, mission: null, checklist: null, events: [], isOpen: false });
    this.#forget();
  }

  /** Take a picture of the station. */
  take(picture) {
    const { page } = this.teams;
    if (picture.kind === "mission") this.#start(picture);
    else if (picture.kind === "event") this.#event(picture);
    else if (picture.kind === "receipt") page.commands.receipt(picture);
    else if (picture.kind === "checklist") this.#list(picture);
    else if (picture.kind === "plan") page.edit(picture);
    else if (picture.kind === "planned") page.editor?.answer(picture);
    else if (picture.kind === "answer") page.commands.answer(picture);
    else if (picture.kind === "team" && this.mission) this.#team(picture); // one that overtook the mission has a successor
  }

  /** Show this team on the page, from what has been received of it. */
  show() {
    const { page } = this.teams;
    page.start(this.mission);
    page.events.start();
    for (const event of this.events) page.events.add(event);
    page.checklist.take(this.checklist ?? { items: [], fault: "", may_tick: false });
    if (this.team) page.show(this.aged, this.past, this.isConnected);
    else page.topbar.update(null, this.isConnected);
  }

  /** Take that the connection has begun or ended. */
  connection(isOpen) {
    this.isOpen = isOpen;
    if (isOpen) this.events = []; // the station sends past events again
    if (isOpen && this.#isChosen) this.teams.page.events.start();
    if (!isOpen) this.teams.page.commands.connectionLost(this.number);
    this.teams.check();
  }

  get number() {
    return this.mission?.team_number ?? 0;
  }

  get isConnected() {
    return this.isOpen && (this.team === null || this.silence_s < SILENCE_MAX_S);
  }

  get silence_s() {
    return (performance.now() - this.arrived_ms) / 1000;
  }

  get aged() {
    return this.team && agedTeam(this.team, this.silence_s);
  }

  get #isChosen() {
    return this.teams.chosen === this;
  }

  #forget() {
    Object.assign(this, { team: null, past: [], arrived_ms: performance.now() });
  }

  #start(mission) {
    if (!isSamePlan(mission, this.mission)) this.#forget();
    this.mission = mission;
    if (this.#isChosen) this.teams.page.start(mission);
    this.teams.extend();
  }

  #event(event) {
    this.events.push(event);
    if (this.events.length > EVENTS_KEPT) this.events.shift();
    if (this.#isChosen) this.teams.page.events.add(event);
  }

  #list(checklist) {
    this.checklist = checklist;
    if (this.#isChosen) this.teams.page.checklist.take(checklist);
  }

  #team(team) {
    this.team = team;
    this.arrived_ms = performance.now();
    const last = this.past.at(-1);
    if (last && (team.time_s ?? 0) < (last.time_s ?? 0)) this.past = []; // another flight has begun
    if (!last || (team.time_s ?? 0) - (last.time_s ?? 0) >= PAST_EVERY_S) this.past.push(team);
    while (this.past.length > PAST_S / PAST_EVERY_S) this.past.shift();
    this.teams.news();
  }
}

/** The teams of a station, one of which the page shows and commands; of the others it shows places and alarms. */
class Teams {
  /** @param {Stream} stream of the first team */
  constructor(stream) {
    this.wakeLock = new WakeLock();
    this.page = new Page((request) => this.chosen.stream.send(request), () => this.chosen.stream.entry.headers);
    this.chosen = new Live(stream, this);
    this.lives = [this.chosen];
    this.chosen.connection(true);
    setInterval(() => this.check(), CHECK_EVERY_MS);
  }

  /** Connect to the other teams that the first one's mission tells of, and name all. */
  extend() {
    const count = this.lives[0].mission?.team_count ?? 1;
    while (this.lives.length < count) this.#connect(this.lives.length);
    showTeams(byId("teams"), this.lives, this.chosen, (live) => this.#choose(live));
  }

  /** A team has sent news: draw, in the next frame. */
  news() {
    this.wakeLock.want(this.lives.some(({ team }) => team && !team.ending));
    this.#warn();
    this.frame ??= requestAnimationFrame(() => this.#draw());
  }

  check() {
    this.#warn();
    if (!this.chosen.team) this.page.topbar.update(null, this.chosen.isConnected);
    else if (this.chosen.silence_s > CHECK_EVERY_MS / 1000) this.frame ??= requestAnimationFrame(() => this.#draw());
  }

  #connect(number) {
    const stream = new Stream(`${streamUrl()}/${number}`, {
      picture: (picture) => live.take(picture),
      connection: (isOpen) => live.connection(isOpen),
    });
    const live = new Live(stream, this);
    this.lives.push(live);
  }

  /** What was selected or asked for was another team's: it is forgotten. */
  #choose(live) {
    if (live === this.chosen || !live.mission) return;
    this.chosen = live;
    for (const dialog of document.querySelectorAll("dialog[open]")) dialog.close();
    this.page.selection.clear();
    live.show();
    this.extend();
  }

  #warn() {
    const isNamed = this.lives.length > 1;
    this.page.alarms.update(
      this.lives.map((live) => ({
        name: isNamed ? (live.mission?.mission ?? `team ${this.lives.indexOf(live) + 1}`) : "",
        team: live.aged,
        isConnected: live.isConnected || Boolean(live.team?.ending),
      })),
    );
  }

  #draw() {
    this.frame = null;
    const { chosen } = this;
    const others = this.lives.filter((live) => live !== chosen && live.team);
    this.page.scene?.showOthers(others.map(({ mission, aged }) => ({ mission, team: aged })));
    if (chosen.team) this.page.show(chosen.aged, chosen.past, chosen.isConnected);
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
    page.alarms.update([{ name: "", team, isConnected: true }]);
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
  let teams = null;
  let flight = null;
  const picture = async (shown) => {
    if (shown.kind !== "recorded") (teams ??= new Teams(stream)).lives[0].take(shown);
    else if (!flight) {
      const fetched = await stream.fetch(flightUrl);
      if (!fetched || flight) return; // after a connection that ended meanwhile, two requests are on their way
      flight = fetched;
      showFlight(flight, () => stream.entry.headers);
    }
  };
  const stream = new Stream(streamUrl(), { picture, connection: (isOpen) => teams?.lives[0].connection(isOpen) });
}

const flightUrl = byId("flight").href;
if (flightUrl.startsWith("blob:")) showFlight(await (await fetch(flightUrl)).json()); // in a report
else openStation(flightUrl);
