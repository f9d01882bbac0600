/** The tabs map, table and strips; arrow keys change them. */

export class Tabs {
  /** @param {HTMLElement} list with role tablist; each tab names its panel @param {function(string)} shown */
  constructor(list, shown) {
    this.tabs = [...list.querySelectorAll("[role=tab]")];
    this.shown = shown;
    for (const tab of this.tabs) tab.addEventListener("click", () => this.show(tab));
    list.addEventListener("keydown", (event) => this.#key(event));
  }

  show(chosen) {
    for (const tab of this.tabs) {
      tab.setAttribute("aria-selected", String(tab === chosen));
      tab.tabIndex = tab === chosen ? 0 : -1;
      document.getElementById(tab.getAttribute("aria-controls")).hidden = tab !== chosen;
    }
    this.shown(chosen.id);
  }

  #key(event) {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const place = this.tabs.indexOf(document.activeElement);
    const next = this.tabs[(place + step + this.tabs.length) % this.tabs.length];
    next.focus();
    this.show(next);
  }
}
