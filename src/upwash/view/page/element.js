// Elements as values. Text is always text: nothing that a log says is read as markup.

const SVG = "http://www.w3.org/2000/svg";

export function element(name, attributes = {}, ...children) {
  return filled(document.createElement(name), attributes, children);
}

export function drawn(name, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, name), attributes, children);
}

function filled(made, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

// Which key does the same; browsers tell others of it by aria-keyshortcuts.
export function keyOf(key) {
  return element("kbd", { "aria-hidden": "true" }, key);
}

// How many "servers" or "drones" have a colour of their own.
export function coloured(kind) {
  return Number(getComputedStyle(document.documentElement).getPropertyValue(`--${kind}`));
}

// A part of the page with a heading of its own.
export function card(heading, ...content) {
  return element("section", { class: "card" }, element("h3", {}, heading), ...content);
}

export function table(heads, body, attributes = {}) {
  const cells = heads.map((head) => element("th", { scope: "col" }, head));
  return element("table", attributes, element("thead", {}, element("tr", {}, ...cells)), body);
}

// Content that scrolls by itself, by keyboard too.
export function scrolled(content, name, style = "scroll") {
  return element("div", { class: style, tabindex: "0", role: "region", "aria-label": name }, content);
}

// A number and its unit are not parted at the end of a line.
export function unparted(words) {
  return words.replace(/(\d) (?=(?:m|s|ms|m\/s|%)(?:[^\w/]|$))/g, "$1\u00a0");
}

// A number with its noun: "1 call", "2 calls".
export function counted(number, noun) {
  return `${number} ${noun}${number === 1 ? "" : "s"}`;
}

// Sets the text only where it changes, so that screen readers are told no more than is new.
export function write(where, text) {
  if (where.textContent !== text) where.textContent = text;
}

export function line(context, fromX, fromY, toX, toY) {
  context.beginPath();
  context.moveTo(fromX, fromY);
  context.lineTo(toX, toY);
  context.stroke();
}
