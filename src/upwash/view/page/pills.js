// Where the numbers of what was found stand on the map: in their places where there is room, or else near them with a leader, which is a thin line; where too many lie close together one count stands for their numbers.

import { overlap, wider } from "./labels.js";
import { DOT_PX, PILL_PX, pillWidth } from "./marks.js";

const GAP_PX = 2;
const CELL_PX = 64; // of the grid by which what lies close together is counted, and others are searched for
const MOST = 6; // numbers in a cell
const MOVES_PX = [0, 20, 28, 36]; // from the place
const TURNS = 8; // directions of a move
const NEAR_PX = 4; // of a click beside one

export class Pills {
  #spots = new Map(); // by finding: where its number or a count is, from its place; null where there is only a dot
  #cells = new Map(); // what is taken, by cell
  boxes = []; // of the numbers and counts

  // By flight: [finding, point] pairs in pixels. Numbers come first that come first.
  arrange(flights) {
    this.#spots.clear();
    this.#cells.clear();
    this.boxes = [];
    const groups = new Map();
    for (const [flight, placed] of flights.entries()) {
      for (const [finding, point] of placed) {
        this.#take(boxAround(point, [0, 0], DOT_PX, DOT_PX), finding);
        const [cell] = cellsOf({ ...point, width: 0, height: 0 });
        const key = `${flight}:${cell}`;
        if (!groups.has(key)) groups.set(key, []);
        groups.get(key).push([finding, point]);
      }
    }
    const ordered = [...groups.values()].sort(([[one]], [[other]]) => one.no - other.no);
    for (const group of ordered) if (group.length > MOST || !this.#number(group)) this.#count(group);
  }

  // Gives each finding of the group its number; whether all have room.
  #number(group) {
    const boxes = [];
    for (const [finding, point] of group) {
      const width = pillWidth(finding.no);
      const free = (box) => this.#isFree(box, [finding]) && !boxes.some((other) => overlap(box, other));
      const move = MOVES.find((each) => free(boxAround(point, each, width, PILL_PX)));
      if (!move) return false;
      boxes.push(wider(boxAround(point, move, width, PILL_PX), GAP_PX));
      this.#spots.set(finding, { move, words: () => finding.no, group: null });
    }
    for (const box of boxes) this.#take(box, null);
    return true;
  }

  // Gives the group one count, at the one that was found first.
  #count(group) {
    const findings = group.map(([finding]) => finding);
    for (const finding of findings) this.#spots.set(finding, null);
    const [first, place] = group.reduce((before, each) => (each[0].at_s < before[0].at_s ? each : before));
    const [x, y] = ["x", "y"].map((axis) => group.reduce((sum, [, point]) => sum + point[axis], 0) / group.length);
    const width = pillWidth(`×${group.length}`);
    const free = (each) => this.#isFree(boxAround({ x, y }, each, width, PILL_PX), []);
    const [right, down] = MOVES.find(free) ?? MOVES[0];
    this.#take(boxAround({ x, y }, [right, down], width, PILL_PX), null);
    const words = (atS) => {
      const found = findings.filter(({ at_s }) => at_s <= atS);
      return found.length > 1 ? `×${found.length}` : found[0]?.no;
    };
    this.#spots.set(first, { move: [x + right - place.x, y + down - place.y], words, group: findings });
  }

  // Whether the box covers no dot, but for those of these findings, and no number.
  #isFree(box, own) {
    return !cellsOf(box).some((key) => this.#cells.get(key)?.some((other) => !own.includes(other.of) && overlap(box, other.box)));
  }

  #take(box, of) {
    if (of === null) this.boxes.push(box);
    for (const key of cellsOf(box)) {
      if (!this.#cells.has(key)) this.#cells.set(key, []);
      this.#cells.get(key).push({ box, of });
    }
  }

  // Whether something else may be written there.
  leaves(box) {
    return this.#isFree(box, []);
  }

  get areDense() {
    return [...this.#spots.values()].some((spot) => spot === null);
  }

  // What is drawn for a finding at that second of its log, each so far from its place; nothing while it has no number.
  signsOf(finding, isCurrent, atS) {
    const spot = this.#spots.get(finding);
    if (spot === undefined) return [];
    const own = { move: [0, 0], words: isCurrent ? finding.no : "", isCurrent };
    if (spot === null) return [own];
    const words = spot.words(atS);
    const counts = spot.group && words !== finding.no;
    return [{ move: spot.move, words, isCurrent: isCurrent && !counts }, ...(isCurrent && counts ? [own] : [])];
  }

  // Whether the finding, whose place is there, is drawn at that point.
  isAt(finding, place, point, atS) {
    const boxes = this.signsOf(finding, false, atS).map(({ move, words }) => {
      return words ? boxAround(place, move, pillWidth(words), PILL_PX) : boxAround(place, move, DOT_PX, DOT_PX);
    });
    if (boxes.length) boxes.push(boxAround(place, [0, 0], DOT_PX, DOT_PX));
    return boxes.some((box) => overlap(wider(box, NEAR_PX), { ...point, width: 0, height: 0 }));
  }

  // The findings that its count stands for, if it has one.
  groupOf(finding) {
    return this.#spots.get(finding)?.group ?? null;
  }
}

// The shortest first.
const MOVES = MOVES_PX.flatMap((away) => {
  return Array.from({ length: away ? TURNS : 1 }, (_, turn) => {
    const angle = (2 * Math.PI * turn) / TURNS;
    return [1.2 * away * Math.sin(angle), -away * Math.cos(angle)]; // numbers are broader than high
  });
});

function boxAround({ x, y }, [right, down], width, height) {
  return { x: x + right - width / 2, y: y + down - height / 2, width, height };
}

// The keys of the cells that the box is in.
function cellsOf({ x, y, width, height }) {
  const cell = (value) => Math.floor(value / CELL_PX);
  const across = [...new Set([cell(x), cell(x + width)])];
  const down = [...new Set([cell(y), cell(y + height)])];
  return across.flatMap((column) => down.map((row) => `${column},${row}`));
}
