/**
 * Camera between key frames, as `clusterviz animate` has it (scene/animation.py): positions on centripetal Catmull-Rom
 * curves, numbers and directions on monotone cubics.
 *
 * @typedef {{time: number, camera: import("./camera.js").Camera}} CameraKey
 */
import {normalized} from "./camera.js";

/** @type {(keys: CameraKey[], time: number) => import("./camera.js").Camera}
 * keys: ascending times, seconds; the camera rests before the first and after the last one */
export function cameraOnPath(keys, time) {
  const times = keys.map((key) => key.time);
  const values = (name) => keys.map((key) => [key.camera[name]].flat());
  const isParallel = keys.every((key) => key.camera.parallel_scale !== null);
  return {
    position: centripetalCurve(times, values("position"), time),
    focal_point: centripetalCurve(times, values("focal_point"), time),
    view_up: normalized(monotoneCurve(times, values("view_up").map(normalized), time)),
    view_angle: monotoneCurve(times, values("view_angle"), time)[0],
    parallel_scale: isParallel ? monotoneCurve(times, values("parallel_scale"), time)[0] : null,
  };
}

/** Number of the segment that holds a time. */
function segmentAt(times, time) {
  const next = times.findIndex((each) => each > time);
  return Math.max(0, (next < 0 ? times.length - 1 : Math.min(next, times.length - 1)) - 1);
}

/** @type {(times: number[], values: number[][], time: number) => number[]} */
function monotoneCurve(times, values, time) {
  if (time <= times[0]) return values[0];
  if (time >= times[times.length - 1]) return values[values.length - 1];
  const i = segmentAt(times, time);
  const step = times[i + 1] - times[i];
  const u = (time - times[i]) / step;
  return values[i].map((from, k) => {
    const to = values[i + 1][k];
    const [low, high] = [curveSlope(times, values, i, k), curveSlope(times, values, i + 1, k)];
    const curve = from + (to - from) * u * u * (3 - 2 * u) + step * u * (1 - u) * ((1 - u) * low - u * high);
    return Math.min(Math.max(curve, Math.min(from, to)), Math.max(from, to));
  });
}

/** Derivative at a key frame: a weighted harmonic mean of both slopes, 0 if their signs differ. */
function curveSlope(times, values, key, k) {
  const rate = (i) => (values[i + 1][k] - values[i][k]) / (times[i + 1] - times[i]);
  const last = times.length - 2;
  if (key === 0 || key > last) return rate(Math.min(key, last));
  const [before, after] = [rate(key - 1), rate(key)];
  if (before * after <= 0) return 0;
  const [short, long] = [times[key] - times[key - 1], times[key + 1] - times[key]];
  const [first, second] = [2 * long + short, long + 2 * short];
  return (first + second) / (first / before + second / after);
}

/** @type {(times: number[], points: number[][], time: number) => number[]} */
function centripetalCurve(times, points, time) {
  const scale = Math.max(...points.flat().map(Math.abs)) || 1;
  const knots = [0];
  for (let i = 1; i < points.length; i += 1) {
    const length = Math.hypot(...points[i].map((value, k) => (value - points[i - 1][k]) / scale));
    knots.push(knots[i - 1] + Math.sqrt(length));
  }
  const i = segmentAt(times, time);
  if (points.length === 1 || knots[i + 1] === knots[i]) return points[i];
  const [knot] = monotoneCurve(times, knots.map((each) => [each]), time);
  const [b, c] = [points[i], points[i + 1]];
  const length = knots[i + 1] - knots[i];
  // Beyond the ends, and beside a constant part, a neighbour is mirrored.
  const hasBefore = i > 0 && knots[i - 1] < knots[i];
  const hasAfter = i + 2 < points.length && knots[i + 2] > knots[i + 1];
  const a = hasBefore ? points[i - 1] : b.map((value, k) => 2 * value - c[k]);
  const d = hasAfter ? points[i + 2] : c.map((value, k) => 2 * value - b[k]);
  const start = hasBefore ? knots[i - 1] : knots[i] - length;
  const end = hasAfter ? knots[i + 2] : knots[i + 1] + length;
  return blendPoints([a, b, c, d], [start, knots[i], knots[i + 1], end], knot);
}

/** Evaluate a Catmull-Rom segment by repeated linear interpolation. */
function blendPoints(points, knots, knot) {
  const blend = (p, q, from, to) => p.map((value, k) => value + ((knot - from) / (to - from)) * (q[k] - value));
  const first = [0, 1, 2].map((k) => blend(points[k], points[k + 1], knots[k], knots[k + 1]));
  const second = [0, 1].map((k) => blend(first[k], first[k + 1], knots[k], knots[k + 2]));
  return blend(second[0], second[1], knots[1], knots[2]);
}
