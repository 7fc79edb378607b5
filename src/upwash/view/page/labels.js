// Labels that give way: to each other, to drones, and to the edge of what they are on.

const STEPS = 10; // that a label may move, in each direction
const GAP_PX = 3;

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
  #labels = new Map(); // by element: its size, of what it says, and how far it has moved

  clear() {
    this.#labels.clear();
  }

  // [element, place] pairs in pixels, and the boxes that nothing may cover.
  arrange(elements, taken) {
    const settled = [...taken];
    for (const [element, { x, y }] of elements) {
      const label = this.#measured(element);
      const at = ([right, down]) => {
        const { width, height } = label;
        return { x: x + right - width / 2, y: y + down - height / 2, width, height, moved: [right, down] };
      };
      const box = firstFree([label.moved, ...ways(label)].map(at), settled); // it stays where it is, if it may
      settled.push({ ...box, x: box.x - GAP_PX, y: box.y - GAP_PX, width: box.width + 2 * GAP_PX, height: box.height + 2 * GAP_PX });
      if (box.moved.join() === label.moved.join() && label.placed) continue;
      Object.assign(label, { moved: box.moved, placed: true });
      element.style.translate = `${box.moved[0]}px ${box.moved[1]}px`;
    }
  }

  #measured(element) {
    const known = this.#labels.get(element);
    if (known?.words === element.textContent) return known;
    const label = { moved: [0, 0], ...known, words: element.textContent, width: element.offsetWidth, height: element.offsetHeight };
    this.#labels.set(element, label);
    return label;
  }
}

// How a label may move, the shortest way first.
function ways({ width, height }) {
  const ways = [];
  for (let step = 0; step <= STEPS; step += 1) {
    for (const right of [0, -width / 2 - 20, width / 2 + 20]) {
      for (const side of step ? [1, -1] : [1]) ways.push([right, (side * step * height) / 2]);
    }
  }
  const length = ([right, down]) => Math.hypot(right, down);
  return ways.sort((one, other) => length(one) - length(other));
}
