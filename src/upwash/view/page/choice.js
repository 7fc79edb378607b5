// Which findings are listed and on the map, and in which order: what a person chooses by sort, label, verdict and threshold.

import { element, write } from "./element.js";

const SORTS = {
  "in order": (one, other) => one.no - other.no,
  "surest first": (one, other) => (other.surest ?? -1) - (one.surest ?? -1) || one.no - other.no,
  "least sure first": (one, other) => (one.surest ?? 2) - (other.surest ?? 2) || one.no - other.no,
  "seen most first": (one, other) => other.sightings - one.sightings || one.no - other.no,
  "newest first": (one, other) => other.at_s - one.at_s || other.no - one.no,
};
const VERDICTS = { "not rejected": ["open", "accepted"], "to review": ["open"], accepted: ["accepted"], rejected: ["rejected"], "all of them": ["open", "accepted", "rejected"] };
const ANY = "any label";

export class Choice {
  constructor(stories, changed) {
    this.stories = stories;
    this.changed = changed;
    this.sort = choiceOf(Object.keys(SORTS), "Order, key s");
    this.label = choiceOf([ANY], "Label");
    this.verdict = choiceOf(Object.keys(VERDICTS), "Review");
    this.least = element("input", { type: "number", min: "0", max: "100", step: "5", value: "0", inputmode: "numeric" });
    this.shown = element("p", { class: "note", role: "status" });
    const least = element("label", { class: "least" }, "at least ", this.least, " %");
    this.element = element("div", { class: "choice" }, this.sort, this.verdict, this.label, least, this.shown);
    this.element.addEventListener("change", () => this.#choose());
  }

  get order() {
    return SORTS[this.sort.value];
  }

  // The next order.
  turn() {
    this.sort.selectedIndex = (this.sort.selectedIndex + 1) % this.sort.length;
    this.#choose();
  }

  #choose() {
    const [label, verdicts, least] = [this.label.value, VERDICTS[this.verdict.value], Number(this.least.value) / 100];
    const wanted = ({ noun, review, surest }) =>
      verdicts.includes(review?.verdict ?? "open") && (label === ANY || noun === label) && (surest ?? 1) >= least - 1e-9;
    for (const story of this.stories) story.want(wanted);
    this.changed();
  }

  // Of the objects that were found, so many are shown.
  tell(objects, shown) {
    const labels = [ANY, ...new Set(objects.map(({ noun }) => noun).filter(Boolean))].sort((one, other) => (one === ANY ? -1 : other === ANY ? 1 : one < other ? -1 : 1));
    const before = this.label.value;
    if (labels.join("\n") !== [...this.label.options].map(({ value }) => value).join("\n")) {
      this.label.replaceChildren(...labels.map((each) => element("option", {}, each)));
      this.label.value = labels.includes(before) ? before : ANY;
    }
    write(this.shown, shown === objects.length ? "" : `${shown} of ${objects.length} shown`);
  }
}

function choiceOf(options, name) {
  return element("select", { "aria-label": name, title: name }, ...options.map((each) => element("option", {}, each)));
}
