// Where the page finds a photo: in the document, or else at the server.

const inDocument = JSON.parse(document.getElementById("photos")?.textContent ?? "null");

// Its address, and its size in pixels where the picture there is smaller; null where there is none.
export function pictureOf(log, run, shot) {
  if (!shot?.kept) return null;
  return inDocument ? (inDocument[`${log}/${shot.number}`] ?? null) : { source: `photos/${log}/${run}/${shot.number}.jpg` };
}
