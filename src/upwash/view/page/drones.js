// The list of several drones or flights, and a chip for each on the map: what each is doing, and which one is in focus.

import { badge } from "./badge.js";
import { lasting, told } from "./clock.js";
import { card, counted, element, write } from "./element.js";
import { stateOf, toneOfBattery } from "./bar.js";

export class DroneList {
  constructor(stories, chosen, title) {
    this.rows = stories.map((story, index) => new Row(story, index, chosen));
    this.together = element("p", { class: "note", role: "status" });
    this.element = card(title, element("ul", { class: "drones" }, ...this.rows.map((row) => row.element)), this.together);
    this.chips = element("div", { class: "chips", role: "group", "aria-label": title }, ...this.rows.map((row) => row.chip));
  }

  focus(index) {
    this.rows.forEach(({ element: item, buttons }, each) => {
      item.classList.toggle("focus", each === index);
      for (const button of buttons) button.setAttribute("aria-pressed", String(each === index));
    });
  }

  // Each at its moment, and how far it is from the first in words.
  show(moments, apart) {
    moments.forEach((moment, index) => this.rows[index].show(moment, apart[index]));
    write(this.together, inAll(moments));
  }
}

// A drone's item in the list, and its chip.
class Row {
  constructor(story, index, chosen) {
    const attributes = { type: "button", "aria-pressed": "false", title: `Look at ${story.name} (key ${index + 1})` };
    const button = element("button", attributes, badge(index + 1), ` ${story.name}`);
    this.chip = element("button", attributes, badge(index + 1), element("span", { class: "name" }, story.name));
    this.buttons = [button, this.chip];
    this.states = [element("span"), element("span")];
    this.batteries = [element("span"), element("span")];
    this.doing = element("p");
    this.facts = element("p", { class: "note" });
    this.chip.append(this.states[0], this.batteries[0]);
    this.element = element("li", {}, element("div", {}, button, this.states[1], this.batteries[1]), this.doing, this.facts);
    for (const each of [this.element, this.chip]) each.addEventListener("click", () => chosen(index));
  }

  show(moment, apart) {
    const { story } = moment;
    const alarm = moment.notices.find(({ level }) => level === "alarm");
    const { who, tone, words } = stateOf(moment);
    const battery = moment.last("battery");
    for (const each of this.states) {
      each.className = `state ${tone}`;
      write(each, who);
    }
    for (const each of this.batteries) {
      each.className = `percent ${toneOfBattery(battery?.battery_percent, moment.stages)}`;
      write(each, battery ? `${battery.battery_percent.toFixed(0)} %` : "");
    }
    write(this.doing, [story.trouble || alarm?.cause || words, apart].filter(Boolean).join(" · "));
    this.doing.className = story.trouble || alarm ? "trouble" : "doing-now";
    const { count, places } = moment.calls;
    const saved = count ? moment.savedS : null;
    const facts = [
      `${moment.reached} of ${counted(story.waypoints, "waypoint")}`,
      moment.using.map((used) => `${used.server} ${used.state}`).join(", ") || "no server",
      `${counted(count, "call")}, ${count - (places.get("local") ?? 0)} on servers`,
      saved === null ? "" : `${lasting(saved)} saved`,
    ];
    write(this.facts, facts.filter(Boolean).join(" · "));
  }
}

// What the missions came to together, once all of them are over.
function inAll(moments) {
  if (!moments.every((moment) => moment.isOver)) return "";
  const completed = moments.filter((moment) => moment.story.isCompleted);
  const words = `${completed.length} of ${moments.length} missions were completed`;
  if (!completed.length) return `${words}.`;
  const timesS = completed.map(({ story }) => story.missionS(story.endsS));
  const mean = timesS.reduce((sum, each) => sum + each, 0) / timesS.length;
  return `${words}: in ${told(mean)} on average, ${told(Math.max(...timesS))} at most.`;
}
