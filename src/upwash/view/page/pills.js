// Where the numbers of what was found stand on the map: above their places, and beside each other.

import { PILL_PX, pillWidth } from "./marks.js";

const ABOVE_PX = 16; // the place
const GAP_PX = 2;
const CELL_PX = 64; // of the grid in which others are searched for
const STEPS = [0, 1, 2, 3, -1, -2]; // sideways
const ROWS = 3;
const NEAR_PX = 4; // of a click beside one

export class Pills {
  #spots = new Map(); // by finding: where its middle is, from its place; null where there is no room

  // [finding, point] pairs in pixels, those first that come first where there is little room.
  arrange(placed) {
    this.#spots.clear();
    const cells = new Map(); // the boxes that are taken, by cell
    for (const [finding, { x, y }] of placed) {
      const width = pillWidth(finding.no);
      const spot = ways(width).find(([right, down]) => !isTaken(cells, x + right, y + down, width));
      if (spot) for (const key of cellsOf(x + spot[0], y + spot[1], width)) take(cells, key, [x + spot[0], y + spot[1], width]);
      this.#spots.set(finding, spot ?? null);
    }
  }

  // From the finding's place; undefined where the finding has no number yet.
  of(finding) {
    return this.#spots.get(finding);
  }

  // Where a finding is drawn whose place is at that point, and how near that is to another point.
  isAt(finding, place, point) {
    const spot = this.#spots.get(finding);
    if (spot === undefined) return false;
    const [right, down] = spot ?? [0, -ABOVE_PX];
    const reach = (spot ? pillWidth(finding.no) : 0) / 2 + NEAR_PX;
    return Math.abs(place.x + right - point.x) <= reach && Math.abs(place.y + down - point.y) <= PILL_PX / 2 + NEAR_PX;
  }
}

export const ABOVE = [0, -ABOVE_PX];

function ways(width) {
  return Array.from({ length: ROWS }, (_, row) => row).flatMap((row) => {
    return STEPS.map((step) => [step * (width + GAP_PX), -ABOVE_PX - row * (PILL_PX + GAP_PX)]);
  });
}

function isTaken(cells, x, y, width) {
  return cellsOf(x, y, width).some((key) => {
    return cells.get(key)?.some(([left, top, wide]) => Math.abs(left - x) < (wide + width) / 2 && Math.abs(top - y) < PILL_PX);
  });
}

function take(cells, key, box) {
  if (!cells.has(key)) cells.set(key, []);
  cells.get(key).push(box);
}

// The keys of the cells that the box is in.
function cellsOf(x, y, width) {
  const cell = (value) => Math.floor(value / CELL_PX);
  const across = [...new Set([cell(x - width / 2), cell(x + width / 2)])];
  const down = [...new Set([cell(y - PILL_PX / 2), cell(y + PILL_PX / 2)])];
  return across.flatMap((column) => down.map((row) => `${column},${row}`));
}
