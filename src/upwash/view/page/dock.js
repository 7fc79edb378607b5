// What is beside the map: tabs, of which one is open. On a phone it slides up over the map.

import { element, write } from "./element.js";

const TITLES = { drones: "Drones", flights: "Flights", now: "Now", findings: "Findings", servers: "Servers", why: "Why" };
const PHONE = matchMedia("(max-width: 60rem)");
const STEPS = { ArrowLeft: -1, ArrowRight: 1 };

export class Dock {
  #open = null; // the name of the tab
  #last; // that was open
  #parts = null; // what the tabs show

  // With tabs of these names; `changed` shows what is new in a tab that opens.
  constructor(names, toggle, changed) {
    this.toggle = toggle;
    this.changed = changed;
    this.tabs = new Map(names.map((name) => [name, this.#tab(name)]));
    this.panels = new Map(names.map((name) => [name, this.#panel(name)]));
    const list = element("div", { class: "tabs", role: "tablist", "aria-label": "Details" }, ...this.tabs.values());
    list.addEventListener("keydown", (event) => this.#step(event));
    this.element = element("div", { class: "dock" }, element("h2", { class: "unseen" }, "Details"), list, ...this.panels.values());
    toggle.onclick = () => this.flip(); // and none before it
    PHONE.onchange = () => this.open(PHONE.matches ? null : this.#first);
    this.open(PHONE.matches ? null : this.#first);
  }

  get #first() {
    return this.tabs.keys().next().value;
  }

  #tab(name) {
    const tab = element("button", { type: "button", role: "tab", id: `tab-${name}`, "aria-controls": `panel-${name}` }, TITLES[name]);
    tab.addEventListener("click", () => this.open(PHONE.matches && this.#open === name ? null : name));
    return tab;
  }

  #panel(name) {
    return element("div", { class: `panel of-${name}`, role: "tabpanel", id: `panel-${name}`, "aria-labelledby": `tab-${name}`, tabindex: "0" });
  }

  #step({ key }) {
    const names = [...this.tabs.keys()];
    const at = names.indexOf(document.activeElement.id.slice("tab-".length)) + (STEPS[key] ?? NaN);
    if (names[at]) this.tabs.get(names[at]).focus();
    if (names[at] && this.#open) this.open(names[at]);
  }

  // Shows the tab of that name; none where it is null.
  open(name) {
    this.#open = name;
    this.#last = name ?? this.#last ?? this.#first;
    for (const [each, tab] of this.tabs) {
      tab.setAttribute("aria-selected", String(each === name));
      tab.setAttribute("tabindex", each === this.#last ? "0" : "-1");
      this.panels.get(each).hidden = each !== name;
    }
    document.getElementById("page").classList.toggle("undocked", !name);
    this.toggle.setAttribute("aria-expanded", String(Boolean(name)));
    write(this.toggle, name ? "Hide details" : "Details");
    this.changed();
  }

  // Hides it, or shows the tab again that was open last.
  flip() {
    this.open(this.#open ? null : this.#last);
  }

  // Shows these elements, by the names of their tabs.
  fill(parts) {
    if (parts === this.#parts) return;
    this.#parts = parts;
    for (const [name, shown] of Object.entries(parts)) this.panels.get(name)?.replaceChildren(...shown);
  }

  // Says beside a tab's title how many there are.
  count(name, number) {
    write(this.tabs.get(name), number ? `${TITLES[name]} ${number}` : TITLES[name]);
  }
}
