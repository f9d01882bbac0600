/** The theme: light, dark, or that of the system; stored in the browser. */

import { setText } from "./dom.js";

const KEY = "cordon-theme";
const NAMES = { automatic: "◐ Auto", light: "○ Light", dark: "● Dark" };
const THEMES = Object.keys(NAMES);

/** @param {HTMLButtonElement} button @param {function()} changed called after every change of the page's colours */
export function startTheme(button, changed) {
  show(button, stored());
  button.addEventListener("click", () => {
    const next = THEMES[(THEMES.indexOf(document.documentElement.dataset.theme) + 1) % THEMES.length];
    store(next);
    show(button, next);
    changed();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
}

/** Whether the page is dark now, by choice or by the system. */
export const isDark = () => getComputedStyle(document.documentElement).colorScheme === "dark";

function show(button, theme) {
  document.documentElement.dataset.theme = theme;
  setText(button.lastElementChild, NAMES[theme]);
}

function stored() {
  try {
    const theme = localStorage.getItem(KEY);
    return THEMES.includes(theme) ? theme : THEMES[0];
  } catch {
    return THEMES[0]; // the browser stores nothing
  }
}

function store(theme) {
  try {
    localStorage.setItem(KEY, theme);
  } catch {
    // it holds until the page is closed
  }
}
