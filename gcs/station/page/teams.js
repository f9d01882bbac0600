/** The choice of the team that the page shows and commands, where a station has several. */

import { element } from "./dom.js";

const COLOURS = ["--team-0", "--team-1", "--team-2", "--team-3"];

/** The colour of a team, as a CSS variable. */
export const teamColour = (number) => `var(${COLOURS[number % COLOURS.length]})`;

/**
 * Show a button for each team; the page has the colour of the chosen one.
 * @param {Live[]} lives @param {Live} chosen @param {function(Live)} choose called when a button is pressed
 */
export function showTeams(root, lives, chosen, choose) {
  root.hidden = lives.length < 2;
  if (root.hidden) return;
  document.body.style.setProperty("--team", teamColour(lives.indexOf(chosen)));
  document.body.dataset.teams = String(lives.length);
  while (root.children.length < lives.length) root.append(button(lives[root.children.length], choose));
  lives.forEach((live, number) => {
    const each = root.children[number];
    each.style.setProperty("--own", teamColour(number));
    each.setAttribute("aria-pressed", String(live === chosen));
    const name = live.mission?.mission ?? `team ${number + 1}`;
    if (each.textContent !== name) each.textContent = name;
  });
}

function button(live, choose) {
  const made = element("button", { type: "button" });
  made.addEventListener("click", () => choose(live));
  return made;
}

/** The symbol of a vehicle of a team that is not chosen. */
export function otherSymbol(mission, vehicle_id) {
  const root = element("div", { class: "other", "data-other": `${mission.team_number} ${vehicle_id}` });
  root.style.borderColor = teamColour(mission.team_number);
  return { root };
}
