/** The top bar: the mission, its time, the ring, the worst alert, the link to the team, and the operator. */

import { byId, SEVERITIES, setAttribute, setText } from "./dom.js";
import { showLost } from "./lost.js";
import { clock } from "./units.js";
import { alert, byTrouble, trouble } from "./vehicles.js";

const SOURCES = {
  flight: "REAL vehicles",
  sitl: "practice on stubs",
  hybrid: "REAL vehicles and stubs",
  plan: "editing the mission",
  unstated: "REAL? not stated",
  bench: "BENCH: simulated bodies",
  simulation: "simulation",
  log: "recorded flight",
};
const GRAVITY = ["alarm", "stale", "warning"];

export class TopBar {
  start(mission) {
    this.mission = mission;
    setText(byId("mission"), mission.mission);
    setText(byId("source"), SOURCES[mission.source]);
    setText(byId("rights"), rights(mission));
  }

  /** Show a TeamPicture, or the fault of the connection. */
  update(team, isConnected) {
    setLine("link", ...linkWords(team, isConnected));
    if (!team) return;
    showLost(team);
    setText(byId("elapsed"), team.time_s === null ? "not started" : `T+ ${clock(team.time_s)}`);
    setText(byId("remaining"), remaining(team, this.mission));
    setText(byId("ring"), `${team.ring_members} of ${team.vehicles.length}`);
    setLine("worst", ...worst(team));
    setText(byId("rights"), rights(this.mission, team));
    setText(byId("ending"), team.ending ? `Flight over: ${team.ending}` : "");
    byId("ending").hidden = !team.ending;
  }
}

function setLine(id, text, state) {
  setText(byId(id), text);
  setAttribute(byId(id), "data-state", state);
}

function remaining(team, mission) {
  if (team.ending || team.time_s === null) return clock(team.ending ? 0 : mission.duration_s);
  return clock(Math.max(0, team.remaining_s ?? mission.duration_s - team.time_s));
}

function linkWords(team, isConnected) {
  if (!isConnected) return ["■ no station", "alarm"];
  if (!team) return ["waiting for data", "warning"];
  if (team.ending) return ["flight over", "information"];
  return team.link ? [`▲ ${team.link}`, "warning"] : ["● connected", "information"];
}

function worst(team) {
  for (const state of GRAVITY) {
    const vehicle = byTrouble(team).find((each) => trouble(each, team) === state);
    if (vehicle) return [`${sign(state)} ${vehicle.vehicle_id}: ${words(vehicle, state)}`, state];
  }
  return team.ending ? ["ended", "ended"] : ["● none", "information"];
}

const sign = (state) => (state === "stale" ? "◌" : SEVERITIES[state].sign);

const words = (vehicle, state) => alert(vehicle) || (state === "stale" ? "stale" : "see card");

function rights(mission, team) {
  if (mission.source === "log") return "recorded";
  const { name, may } = mission.operator;
  if (may.length) return name || "this page";
  return team?.ending || team?.lost ? "flight over" : "read only";
}
