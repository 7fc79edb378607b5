// A field in the head of each page that finds words in all of them. The words come when the field is first entered, as a script:
// that works for pages that are opened as files, too.

(() => {
  const MOST = 20; // results
  const BEFORE = 60; // characters of the excerpt, before the first word that was found
  const LONG = 180; // characters of an excerpt
  const [OWN, OF_PAGE, IN_TEXT] = [50, 20, 9]; // what a word counts in the title, in the page's title, and at most in the text
  const BEGUN = 0.5; // of that, if only the beginning of a word was typed
  const root = document.currentScript.src.replace(/search\.js$/, "");
  let sections = null;

  const form = made("form", { className: "find", role: "search" });
  const field = made("input", { type: "search", placeholder: "Search", ariaLabel: "Search", autocomplete: "off" });
  const results = made("div", { className: "found", hidden: true });
  const count = made("p", { role: "status" });
  const list = made("ol", {});
  results.append(count, list);
  form.append(field, results);
  document.querySelector(".md-header__inner").append(form);

  window.searchWords = (words) => {
    sections = words.map(([address, page, title, text, also]) => ({ address, page, title, text, also }));
    show();
  };

  field.addEventListener("focus", load);
  field.addEventListener("input", show);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    list.querySelector("a")?.click();
  });
  form.addEventListener("focusout", ({ relatedTarget }) => form.contains(relatedTarget) || hide());
  form.addEventListener("focusin", show);
  document.addEventListener("keydown", (event) => {
    if (event.key === "/" && !event.target.closest("input, textarea, select")) {
      event.preventDefault();
      field.focus();
    } else if (event.key === "Escape" && form.contains(event.target)) {
      field.focus();
      hide();
    } else if (["ArrowDown", "ArrowUp"].includes(event.key) && form.contains(event.target)) {
      event.preventDefault();
      const stops = [field, ...list.querySelectorAll("a")];
      stops[stops.indexOf(event.target) + (event.key === "ArrowDown" ? 1 : -1)]?.focus();
    }
  });

  function load() {
    if (!sections && !document.querySelector("script[data-words]")) {
      const script = made("script", { src: `${root}search_words.js` });
      script.dataset.words = "";
      document.head.append(script);
    }
  }

  function hide() {
    results.hidden = true;
  }

  function show() {
    const words = wordsOf(field.value);
    results.hidden = !words.length || !sections;
    if (results.hidden) return;
    const found = sections.map((section) => [points(section, words), section]).filter(([score]) => score > 0);
    found.sort(([one], [other]) => other - one); // equals stay in the order of the pages
    const first = found.length > MOST ? `${MOST} of ` : "";
    count.textContent = `${first}${found.length || "no"} result${found.length === 1 ? "" : "s"}`;
    list.replaceChildren(...found.slice(0, MOST).map(([, section]) => row(section, words)));
  }

  // Each word as what finds it whole, and what finds it as far as it is typed: the last one may go on.
  function wordsOf(query) {
    const words = query.toLowerCase().split(/\s+/).map((word) => word.replace(/^[^\p{L}\p{N}]+|[^\p{L}\p{N}]+$/gu, "")).filter(Boolean);
    return words.map((word, index) => {
      const isTyped = index === words.length - 1 && !/\s$/.test(query);
      const singular = word.length > 3 ? word.replace(/(?<!s)s$/, "") : word;
      const whole = `(?<![\\p{L}\\p{N}])${escaped(singular)}(?:e?s)?(?![\\p{L}\\p{N}])`;
      const begun = `(?<![\\p{L}\\p{N}])${escaped(word)}[\\p{L}\\p{N}]*`;
      return { whole: new RegExp(whole, "giu"), seen: new RegExp(isTyped ? `${whole}|${begun}` : whole, "giu") };
    });
  }

  // How well the section fits: nothing where a word is missing.
  function points({ title, page, text, also }, words) {
    let sum = 0;
    for (const { whole, seen } of words) {
      const share = (where) => (where.search(whole) >= 0 ? 1 : where.search(seen) >= 0 ? BEGUN : 0);
      const inTitle = share(title) * OWN * (1 + 1 / title.split(" ").length); // more of a short one
      const inPage = share(page) * OF_PAGE;
      const inAlso = share(also) * OWN; // other names of the page
      const inText = share(text) * Math.min(IN_TEXT, text.match(seen)?.length ?? 0);
      const worth = inTitle + inPage + inAlso + inText;
      if (worth === 0) return 0;
      sum += worth;
    }
    return sum;
  }

  function row({ address, page, title, text }, words) {
    const link = made("a", { href: root + address });
    const first = Math.min(...words.map(({ seen }) => text.search(seen)).filter((place) => place >= 0), text.length);
    const begin = first === text.length ? 0 : Math.max(0, text.lastIndexOf(" ", Math.max(0, first - BEFORE)) + 1);
    const end = begin + LONG < text.length ? text.lastIndexOf(" ", begin + LONG) : text.length;
    const excerpt = `${begin ? "… " : ""}${text.slice(begin, end)}${end < text.length ? " …" : ""}`;
    link.append(
      marked("strong", title, words),
      ...(page === title ? [] : [made("span", { textContent: ` · ${page}` })]),
      marked("p", excerpt, words),
    );
    const item = made("li", {});
    item.append(link);
    return item;
  }

  // The text with what was found in it marked.
  function marked(tag, text, words) {
    const element = made(tag, {});
    const all = new RegExp(words.map(({ seen }) => seen.source).join("|"), "giu");
    let end = 0;
    for (const { 0: found, index } of text.matchAll(all)) {
      element.append(text.slice(end, index), made("mark", { textContent: found }));
      end = index + found.length;
    }
    element.append(text.slice(end));
    return element;
  }

  function escaped(word) {
    return word.replace(/[.*+?^${}()|[\]\\/-]/g, "\\$&");
  }

  function made(tag, properties) {
    return Object.assign(document.createElement(tag), properties);
  }
})();
