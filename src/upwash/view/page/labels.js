// Labels that give way: to each other, to what they may not cover, and to the edge of what they are on.

const STEPS = 10; // that a label may move, in each direction
const GAP_PX = 3;
const BACK_PX = 15; // that have to be free around a place before a label comes back to it

// Boxes are { x, y, width, height }, x and y of the corner at the upper left.
export function overlap(one, other) {
  return (
    one.x < other.x + other.width && other.x < one.x + one.width &&
    one.y < other.y + other.height && other.y < one.y + one.height
  );
}

// The first of the boxes that covers none of those taken; the very first, where all do.
export function firstFree(boxes, taken) {
  return boxes.find((box) => !taken.some((other) => overlap(box, other))) ?? boxes[0];
}

export function within(box, width, height) {
  const into = (from, size, room) => Math.max(0, Math.min(from, room - size));
  return { ...box, x: into(box.x, box.width, width), y: into(box.y, box.height, height) };
}

// Elements that stand in the middle of their places, or beside it where something is in the way.
export class Labels {
  #labels = new Map(); // by element: its sizes, by what it says, and how far it has moved

  clear() {
    this.#labels.clear();
  }

  // [element, place] pairs in pixels, and the boxes that nothing may cover. A label that moved aside stays there until
  // there is plenty of room.
  arrange(elements, taken) {
    const settled = [...taken];
    for (const [element, { x, y }] of elements) {
      if (!this.#labels.has(element)) this.#labels.set(element, { sizes: new Map(), moved: null });
      const label = this.#labels.get(element);
      const { width, height } = sizeOf(element, label.sizes);
      const at = ([right, down]) => {
        return { x: x + right - width / 2, y: y + down - height / 2, width, height, moved: [right, down] };
      };
      const roomy = !settled.some((other) => overlap(wider(at([0, 0]), BACK_PX), other));
      const moves = [...(label.moved && !roomy ? [label.moved] : []), ...ways(width, height)];
      const box = firstFree(moves.map(at), settled);
      settled.push(wider(box, GAP_PX));
      if (box.moved.join() !== label.moved?.join()) element.style.translate = box.moved.map((each) => `${each}px`).join(" ");
      label.moved = box.moved;
    }
  }
}

function sizeOf(element, sizes) {
  const words = element.textContent;
  if (!sizes.has(words)) sizes.set(words, { width: element.offsetWidth, height: element.offsetHeight });
  return sizes.get(words);
}

export function wider({ x, y, width, height }, by) {
  return { x: x - by, y: y - by, width: width + 2 * by, height: height + 2 * by };
}

// How a label may move, the shortest way first.
function ways(width, height) {
  const ways = [];
  for (let step = 0; step <= STEPS; step += 1) {
    for (const right of [0, -width / 2 - 20, width / 2 + 20]) {
      for (const side of step ? [1, -1] : [1]) ways.push([right, (side * step * height) / 2]);
    }
  }
  const length = ([right, down]) => Math.hypot(right, down);
  return ways.sort((one, other) => length(one) - length(other));
}
