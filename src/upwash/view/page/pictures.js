// Where the page finds pictures and files: in the document, or else at the server.

const inDocument = dataOf("photos");

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
