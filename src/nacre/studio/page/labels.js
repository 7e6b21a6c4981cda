// Placement of the labels of points: labels overlap neither each other nor points, and curves as little as possible.

const LETTER = 5.4, HEIGHT = 11, RINGS = [8, 17, 27, 38], WAYS = [[1, -0.7], [1, 0.7], [-1, -0.7], [-1, 0.7], [0, -1], [0, 1], [1, 0], [-1, 0]];
const OVER = 10, OUTSIDE = 100, ON_CURVE = 6, FARTHER = 0.3;      // costs of a square unit, a point of a curve, a unit of distance

export const boxOf = (x, y, text) => [x - 0.5 * LETTER * text.length, y - 0.5 * HEIGHT, x + 0.5 * LETTER * text.length, y + 0.5 * HEIGHT];
const shared = (a, b) => Math.max(Math.min(a[2], b[2]) - Math.max(a[0], b[0]), 0) * Math.max(Math.min(a[3], b[3]) - Math.max(a[1], b[1]), 0);
const area = ([left, top, right, bottom]) => (right - left) * (bottom - top);

// Return the centre of each label, and whether it needs a leader line. `points`: x, y, radius r and text; `taken`: forbidden
// boxes; `curve`: points to avoid; `frame`: the box of the drawing.
export function placeLabels(points, taken, curve, frame) {
  const boxes = [...taken, ...points.map(({ x, y, r }) => [x - r, y - r, x + r, y + r])];
  return points.map(({ x, y, text }) => {
    let best = null;
    for (const far of RINGS) {
      for (const [dx, dy] of WAYS) {
        const at = [x + dx * (far + 0.5 * LETTER * text.length), y + dy * (far + 2)], box = boxOf(...at, text);
        const over = boxes.reduce((sum, other) => sum + shared(box, other), 0), outside = area(box) - shared(box, frame);
        const covers = curve.reduce((sum, [a, b]) => sum + (a > box[0] && a < box[2] && b > box[1] && b < box[3] ? 1 : 0), 0);
        const cost = OVER * over + OUTSIDE * outside + ON_CURVE * covers + FARTHER * far;
        if (!best || cost < best.cost) best = { cost, x: at[0], y: at[1], box, isLed: far > RINGS[0] };
      }
    }
    boxes.push(best.box);
    return best;
  });
}
