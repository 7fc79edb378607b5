// Where the page finds pictures and files: in the document, or else at the server.

const AT_ONCE = 3; // a browser has six connections to a program: some are free for what a person does meanwhile
const inDocument = dataOf("photos");
const sources = new WeakMap(); // of pictures that nobody has seen yet
const waiting = []; // of those that are seen
let loading = 0;

function dataOf(id) {
  return JSON.parse(document.getElementById(id)?.textContent ?? "null");
}

// Its address, and its size in pixels where the picture there is smaller; null where there is none.
export function pictureOf(log, run, shot) {
  if (!shot?.kept) return null;
  return inDocument ? (inDocument[`${log}/${shot.number}`] ?? null) : { source: `photos/${log}/${run}/${shot.number}.jpg` };
}

// The address of the picture of what was found, the `index`th of the log; null where there is none.
export function cropOf(log, run, { pictured, index }) {
  if (!pictured) return null;
  if (!inDocument) return `crops/${log}/${run}/${index}.jpg`;
  return document.getElementById(`crop-${log}-${index}`)?.getAttribute("href") ?? null;
}

// The files of what was found: the name and the address of each.
export function filesOfFindings() {
  if (!inDocument) return ["csv", "geojson", "kml", "zip"].map((format) => [`findings.${format}`, `findings.${format}`]);
  const files = Object.entries(dataOf("files") ?? {});
  return files.map(([name, text]) => [name, URL.createObjectURL(new Blob([text], { type: "text/plain" }))]);
}

// Loads a picture once it is in sight, a few at a time.
export function loadSeen(image, source) {
  sources.set(image, source);
  sight.observe(image);
}

const sight = new IntersectionObserver((entries) => {
  for (const { target } of entries.filter(({ isIntersecting }) => isIntersecting)) {
    sight.unobserve(target);
    waiting.push(target);
  }
  loadNext();
});

function loadNext() {
  while (loading < AT_ONCE && waiting.length) {
    const image = waiting.shift();
    loading += 1;
    for (const end of ["load", "error"]) image.addEventListener(end, loaded, { once: true });
    image.src = sources.get(image);
  }
}

function loaded() {
  loading -= 1;
  loadNext();
}
