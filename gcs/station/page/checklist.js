/** The mission's checklist: shown until the team has taken off; each tick goes to the station. */

import { byId, element, setText } from "./dom.js";

export class Checklist {
  /** @param {function(Object): boolean} send passes a tick to the station */
  constructor(send) {
    this.send = send;
    this.items = [];
    this.boxes = [];
  }

  /** Show a ChecklistPicture. */
  take({ items, fault, may_tick }) {
    if (items.map(({ text }) => text).join() !== this.items.map(({ text }) => text).join()) this.#make(items);
    this.items = items;
    items.forEach((item, index) => {
      const { box, by } = this.boxes[index];
      box.checked = isTicked(item);
      box.disabled = !may_tick;
      setText(by, whoText(item));
    });
    const open = items.filter((item) => item.required && !isTicked(item));
    const isUsed = open.length > 0 && open.every((item) => item.used);
    const state = isUsed ? "done for the last start: tick it again for the next" : `${open.length} of ${items.length} open: nothing is armed`;
    setText(byId("checklist-state"), fault || (open.length ? state : "complete"));
    byId("checklist").dataset.state = fault || (open.length && !isUsed) ? "open" : "done";
    this.#show();
  }

  /** Hide it once the mission has begun. */
  update(team) {
    this.hasBegun = team.time_s !== null;
    this.#show();
  }

  #show() {
    byId("checklist").hidden = this.items.length === 0 || Boolean(this.hasBegun);
  }

  #make(items) {
    this.boxes = items.map((item, index) => {
      const box = element("input", { type: "checkbox" });
      const by = element("span", { class: "by" });
      const label = element("label", {}, box, element("span", {}, item.required ? item.text : `${item.text} (optional)`), by);
      box.addEventListener("change", () => this.send({ kind: "tick", item: index, ticked: box.checked }) || (box.checked = !box.checked));
      return { box, by, item: element("li", {}, label) };
    });
    byId("checklist-items").replaceChildren(...this.boxes.map(({ item }) => item));
  }
}

const isTicked = ({ by, used }) => Boolean(by) && !used;

function whoText({ by, wall_s, used }) {
  if (!by) return "";
  return `${used ? "used: " : ""}${by}, ${new Date(wall_s * 1000).toLocaleTimeString([], { hour12: false })}`;
}
