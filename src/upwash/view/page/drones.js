// The list of several drones: what each is doing, and which one is in focus.

import { badge } from "./badge.js";
import { lasting, told } from "./clock.js";
import { element, table, write } from "./element.js";
import { stateOf, toneOfBattery } from "./bar.js";

const HEADS = ["drone", "doing", "waypoints", "server", "calls", "saved", "battery"];
const WIDE = new Set(["server", "calls", "saved"]); // left out on a phone

export class DroneList {
  constructor(stories, chosen) {
    this.rows = stories.map((story, index) => this.#row(story, index, chosen));
    this.together = element("p", { class: "note", role: "status" });
    const body = element("tbody", {}, ...this.rows.map((row) => row.element));
    this.table = table(HEADS, body, { class: "drones" });
    [...this.table.tHead.rows[0].cells].forEach((head, index) => head.classList.toggle("wide", WIDE.has(HEADS[index])));
    this.element = element("section", { class: "card list" }, element("h2", {}, "Drones"), this.table, this.together);
  }

  #row(story, index, chosen) {
    const button = element("button", { type: "button", "aria-pressed": "false" }, badge(index + 1), ` ${story.name}`);
    button.title = `Look at ${story.name} (key ${index + 1})`;
    const cells = Object.fromEntries(HEADS.slice(1).map((head) => [head, element("td")]));
    cells.doing.append(element("span"), " ", element("span"));
    for (const head of WIDE) cells[head].classList.add("wide");
    const name = element("th", { scope: "row" }, button);
    const row = element("tr", {}, name, ...Object.values(cells));
    row.addEventListener("click", () => chosen(index));
    return { element: row, button, cells };
  }

  focus(index) {
    this.rows.forEach(({ element: row, button }, each) => {
      row.classList.toggle("focus", each === index);
      button.setAttribute("aria-pressed", String(each === index));
    });
  }

  show(moments) {
    moments.forEach((moment, index) => showRow(this.rows[index].cells, moment));
    this.table.classList.toggle("endless", !moments.some((moment) => moment.last("battery")));
    write(this.together, inAll(moments));
  }
}

function showRow(cells, moment) {
  const { story } = moment;
  const alarm = moment.notices.find(({ level }) => level === "alarm");
  const { who, tone, words } = stateOf(moment);
  const [chip, doing] = cells.doing.children;
  chip.className = `state ${tone}`;
  write(chip, who);
  write(doing, story.trouble || alarm?.cause || words);
  doing.className = story.trouble || alarm ? "trouble" : "";
  write(cells.waypoints, `${moment.reached} of ${story.waypoints}`);
  write(cells.server, moment.using.map((used) => `${used.server} ${used.state}`).join(", ") || "none");
  const { count, places } = moment.calls;
  write(cells.calls, `${count}, ${count - (places.get("local") ?? 0)} on servers`);
  const saved = moment.savedS;
  write(cells.saved, saved === null || !count ? "" : lasting(saved));
  const battery = moment.last("battery");
  write(cells.battery, battery ? `${battery.battery_percent.toFixed(0)} %` : "");
  cells.battery.className = toneOfBattery(battery?.battery_percent, moment.stages);
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
