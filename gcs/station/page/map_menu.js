/** The menu of a place on the map: what can be done there, by mouse, finger or keyboard. */

import { element } from "./dom.js";

const MOVES = { ArrowDown: 1, ArrowUp: -1 };

export class MapMenu {
  /** @param {HTMLElement} container of the map @param {function()} back gives the keyboard back to where the menu was opened */
  constructor(container, back) {
    this.container = container;
    this.back = back;
    this.root = element("div", { id: "map-menu", hidden: true });
    this.list = element("div", { role: "menu", "aria-labelledby": "map-menu-place" });
    this.title = element("p", { id: "map-menu-place" });
    this.root.append(this.title, this.list);
    document.body.append(this.root); // the map may be smaller than the menu
    this.root.addEventListener("keydown", (event) => this.#key(event));
    document.addEventListener("pointerdown", (event) => !this.root.contains(event.target) && this.close(), { capture: true });
    this.root.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  get isOpen() {
    return !this.root.hidden;
  }

  /**
   * Open the menu at a pixel of the map.
   * @param {string} place its title
   * @param {{name: string, act: function(), disabled: boolean}[]} choices @param {boolean} isByKey whether the keyboard opened it
   */
  open({ x, y }, place, choices, isByKey) {
    this.isByKey = isByKey;
    this.title.textContent = place;
    this.list.replaceChildren(...choices.map((choice) => this.#item(choice)));
    this.root.hidden = false;
    const { left, top } = this.container.getBoundingClientRect();
    const { offsetWidth, offsetHeight } = this.root;
    this.root.style.left = `${Math.max(0, Math.min(left + x, innerWidth - offsetWidth))}px`;
    this.root.style.top = `${Math.max(0, Math.min(top + y, innerHeight - offsetHeight))}px`;
    this.#items[0]?.focus({ preventScroll: true });
  }

  close() {
    this.root.hidden = true;
  }

  get #items() {
    return [...this.list.querySelectorAll("button:not(:disabled)")];
  }

  #item({ name, act, why }) {
    const item = element("button", { type: "button", role: "menuitem", tabindex: "-1", disabled: Boolean(why) }, name);
    if (why) item.append(element("small", {}, why));
    item.addEventListener("click", () => {
      this.close();
      if (this.isByKey) this.back();
      act();
    });
    return item;
  }

  #key(event) {
    const items = this.#items;
    const at = items.indexOf(document.activeElement);
    if (event.key === "Escape" || event.key === "Tab") {
      event.preventDefault();
      this.close();
      this.back();
    } else if (event.key in MOVES) {
      event.preventDefault();
      items[(at + MOVES[event.key] + items.length) % items.length].focus();
    } else if (event.key === "Home" || event.key === "End") {
      event.preventDefault();
      items.at(event.key === "Home" ? 0 : -1).focus();
    }
    if (event.key !== "h") event.stopPropagation(); // hold works everywhere
  }
}
