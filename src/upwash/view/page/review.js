// What a person decides about the finding that is selected: accepted or rejected, another label, a note.

import { element, keyOf, write } from "./element.js";
import { wordsOf } from "./found.js";

const LONGEST = { label: 100, note: 1000, reviewer: 100 };
const OPEN = { verdict: "open", label: "", note: "" };
let forms = 0; // on the page, each with names of its own

export class ReviewPanel {
  #target = null; // what is reviewed: { story, log, finding }
  #undone = []; // what was there before each review made here
  #shown = "";
  #counted = []; // by story: what was found, as it is counted
  #links = "";

  // `log` is that of the first story, `move` selects the finding that many places further down the list, `advance` the next one without a verdict,
  // and `changed` shows what is new.
  constructor(stories, name, desk, { log, move, advance, changed }) {
    this.stories = stories;
    this.logs = stories.map((_, index) => log + index);
    this.desk = desk;
    this.move = move;
    this.advance = advance;
    this.changed = changed;
    this.about = element("p", { class: "target" });
    this.crop = element("span", { class: "crop" });
    this.accept = this.#button("Accept", "a", () => this.#decide("accepted"));
    this.reject = this.#button("Reject", "r", () => this.#decide("rejected"));
    this.undo = this.#button("Undo", "u", () => this.#takeBack());
    this.form = this.#makeForm();
    this.more = element("details", { class: "more" }, element("summary", {}, "Label ", keyOf("l"), " or note ", keyOf("m")), this.form);
    this.tally = element("span", { class: "tally" });
    this.downloads = element("span", { class: "made" });
    this.remarks = element("p", { class: "note" });
    this.said = element("p", { class: "said", role: "status" });
    this.element = element(
      "section",
      { class: "review", "aria-label": `Review, ${name}` },
      this.crop,
      this.about,
      element("div", { class: "verdicts" }, this.accept, this.reject, this.undo),
      element("p", { class: "count" }, this.tally, this.downloads, element("span", { class: "keys" }, keyOf("n"), " next ", keyOf("p"), " previous")),
      this.more,
      this.remarks,
      this.said,
    );
  }

  #button(words, key, act) {
    const button = element("button", { type: "button", "aria-keyshortcuts": key, title: `Key ${key}` }, words, " ", keyOf(key));
    button.addEventListener("click", act);
    return button;
  }

  #makeForm() {
    forms += 1;
    const list = `labels-${forms}`;
    this.labels = element("datalist", { id: list });
    this.fields = Object.fromEntries(
      Object.entries({ label: { list }, note: {}, reviewer: { autocomplete: "name" } }).map(([name, more]) => {
        const attributes = { type: "text", dir: "auto", maxlength: LONGEST[name], autocomplete: "off", ...more };
        return [name, element("input", attributes)];
      }),
    );
    this.fields.reviewer.value = this.desk.reviewer;
    const words = { label: "Another label", note: "Note", reviewer: "Your name" };
    const rows = Object.entries(this.fields).map(([name, field]) => element("label", {}, element("span", {}, words[name]), field));
    const form = element("form", {}, ...rows, this.labels, element("button", { type: "submit" }, "Save"));
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.#write();
    });
    form.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.#fold();
    });
    return form;
  }

  // Shows the review of the finding that is selected, if one is, and how many are reviewed.
  show(target) {
    const review = target ? reviewOf(target.finding) : OPEN;
    const shown = JSON.stringify([target?.finding.no, target?.finding.surest, review]);
    this.#target = target;
    if (shown !== this.#shown) this.#fill(target, review);
    this.#shown = shown;
    for (const button of [this.accept, this.reject]) button.disabled = !target;
    this.undo.disabled = !this.#undone.length;
    this.accept.setAttribute("aria-pressed", String(review.verdict === "accepted"));
    this.reject.setAttribute("aria-pressed", String(review.verdict === "rejected"));
    this.#count();
    this.#offer();
  }

  #fill(target, { label, note }) {
    this.more.hidden = !target;
    [this.fields.label.value, this.fields.note.value] = [label, note];
    if (!target) {
      this.about.replaceChildren("Select a finding to review it.");
      this.crop.replaceChildren();
      return;
    }
    const { finding } = target;
    const shown = wordsOf({ ...finding, score: finding.surest ?? undefined });
    const number = element("span", { class: "number" }, String(finding.no));
    this.about.replaceChildren(number, " ", element("bdi", {}, shown));
    this.crop.replaceChildren(...(target.source ? [element("img", { alt: "", src: target.source })] : []));
    const known = new Set(this.stories.flatMap((story) => story.objects.map((each) => reviewOf(each).label || each.what)));
    this.labels.replaceChildren(...[...known].sort().map((each) => element("option", { value: each })));
  }

  #count() {
    const { stories } = this;
    if (stories.every(({ found }, index) => found === this.#counted[index])) return;
    this.#counted = stories.map(({ found }) => found);
    const all = this.stories.flatMap((story) => story.objects).map(reviewOf);
    const rejected = all.filter(({ verdict }) => verdict === "rejected").length;
    const reviewed = all.filter(({ verdict }) => verdict !== "open").length;
    write(this.tally, `${reviewed} of ${all.length} reviewed${rejected ? `, ${rejected} rejected` : ""}`);
    write(this.remarks, this.stories[0].found.remarks.map(sentence).join(" "));
    this.remarks.hidden = !this.remarks.textContent;
  }

  // The files with what was reviewed here and is kept nowhere else.
  #offer() {
    const files = this.desk.filesOf(this.logs);
    const key = JSON.stringify(files);
    if (key === this.#links) return;
    this.#links = key;
    for (const link of this.downloads.children) URL.revokeObjectURL(link.href);
    const links = files.map(([name, lines]) => {
      const address = URL.createObjectURL(new Blob(lines, { type: "text/plain" }));
      return element("a", { href: address, download: name }, `Download ${name}`);
    });
    this.downloads.replaceChildren(...links);
  }

  // What a key does here, if it does something. Keys that change a review are those of this part of the page alone.
  wayOf(key, isHere) {
    const ways = { n: () => this.move(1), p: () => this.move(-1) };
    const own = { u: () => this.#takeBack() };
    const ofTarget = {
      a: () => this.#decide("accepted"),
      r: () => this.#decide("rejected"),
      l: () => this.#unfold(this.fields.label),
      m: () => this.#unfold(this.fields.note),
    };
    return ways[key] ?? (isHere ? (own[key] ?? (this.#target ? ofTarget[key] : null)) : null);
  }

  #unfold(field) {
    this.more.open = true;
    field.focus();
    field.select();
  }

  #fold() {
    this.more.open = false;
    this.more.firstElementChild.focus();
  }

  #decide(verdict) {
    const target = this.#target;
    const review = { ...reviewOf(target.finding), verdict };
    this.#keep(target, review);
    this.advance();
  }

  // The label and the note as they are written; another label accepts the finding.
  #write() {
    this.desk.reviewer = this.fields.reviewer.value;
    const before = reviewOf(this.#target.finding);
    const [label, note] = [this.fields.label.value.trim(), this.fields.note.value.trim()];
    const verdict = label && label !== before.label ? "accepted" : before.verdict;
    this.#keep(this.#target, { verdict, label, note });
    this.#fold();
  }

  #takeBack() {
    const last = this.#undone.pop();
    if (!last) return;
    this.#keep(last.target, last.before, false);
    this.advance(last.target);
  }

  // Shows the review at once, and what was there before where it was not kept.
  async #keep(target, { verdict, label, note }, canBeUndone = true) {
    const { story, log, finding } = target;
    const before = reviewOf(finding);
    const review = { verdict, label, note };
    if (canBeUndone) this.#undone.push({ target, before });
    this.#set(target, review);
    write(this.said, `Finding ${finding.no} ${said(review)}.`);
    const problem = await this.desk.keep(log, { finding: finding.key, ...review });
    if (problem && story.told[finding.index] === finding) {
      if (canBeUndone) this.#undone = this.#undone.filter((each) => each.before !== before || each.target !== target);
      this.#set(target, before);
    }
    if (problem) write(this.said, problem);
    this.changed();
  }

  #set({ finding }, review) {
    for (const story of this.stories) story.review(finding.no, review);
    this.changed();
  }
}

function reviewOf({ review }) {
  return review ?? OPEN;
}

function said({ verdict, label }) {
  const as = label ? ` as ${label}` : "";
  return verdict === "open" ? `open again${as}` : `${verdict}${as}`;
}

function sentence(words) {
  return `${words.slice(0, 1).toUpperCase()}${words.slice(1)}.`;
}
