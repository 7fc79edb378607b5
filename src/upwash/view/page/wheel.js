// A wheel scrolls the page wherever it is turned. Over a figure it zooms with Ctrl, and over the map after a click too.

import { element } from "./element.js";

const HINT_MS = 1500;

// Lets only those turns of the wheel into the frame that zoom what is in it. `byClick` says whether a click does that, until the pointer leaves.
export function guardWheel(frame, words, { byClick = false } = {}) {
  const hint = element("p", { class: "hint", "aria-hidden": "true", hidden: "" }, words);
  let isEntered = false;
  let timer = null;
  const show = (isShown) => (hint.hidden = !isShown);
  frame.append(hint);
  frame.addEventListener("click", () => (isEntered = byClick));
  frame.addEventListener("pointerleave", () => show((isEntered = false)));
  const take = (event) => {
    const isAlone = byClick && document.documentElement.scrollHeight <= innerHeight; // nothing else could be meant
    const zooms = isAlone || isEntered || event.ctrlKey || event.metaKey;
    show(!zooms);
    clearTimeout(timer);
    timer = setTimeout(show, HINT_MS, false);
    if (!zooms) event.stopPropagation();
  };
  frame.addEventListener("wheel", take, { capture: true, passive: true });
}
