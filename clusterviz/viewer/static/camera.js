/**
 * Camera mathematics without state: every function takes a camera and returns another. Conventions are VTK's.
 *
 * @typedef {[number, number, number]} Vector
 * @typedef {{position: Vector, focal_point: Vector, view_up: Vector, view_angle: number,
 *   parallel_scale: ?number}} Camera
 *   world units; view_angle is vertical, degrees; parallel_scale is half the picture's height, null for perspective
 * @typedef {{right: Vector, up: Vector, forward: Vector}} Axes unit vectors, world
 */

/** Margin around a fitted scene, as a share of half the picture's sides. */
const FIT_MARGIN = 0.04;
/** Smallest distance of a fitted eye from the centre, in radii of the bounding sphere. */
const FIT_RADII = 1.05;
/** Anatomical direction of x, y and z for data without an orientation. */
const DEFAULT_ORIENTATION = "RPS";
const OPPOSITE_SIDES = {L: "R", R: "L", A: "P", P: "A", S: "I", I: "S"};
const EYE_SIDES = {front: "A", back: "P", left: "L", right: "R", top: "S", bottom: "I"};
const ANATOMICAL_NAMES = {A: "anterior", P: "posterior", L: "left", R: "right", S: "superior", I: "inferior"};

/** @type {(a: Vector, b: Vector, factor?: number) => Vector} a + factor · b */
export function addScaled(a, b, factor = 1) {
  return [a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]];
}

/** @type {(a: Vector, b: Vector) => Vector} a − b */
export function subtract(a, b) {
  return addScaled(a, b, -1);
}

/** @type {(a: Vector, b: Vector) => number} */
export function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/** @type {(a: Vector, b: Vector) => Vector} */
export function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/** @type {(a: Vector) => Vector} */
export function normalized(a) {
  const length = Math.hypot(...a);
  return [a[0] / length, a[1] / length, a[2] / length];
}

/** Rotate a vector about a unit axis by Rodrigues' formula.
 * @type {(vector: Vector, axis: Vector, degrees: number) => Vector} */
export function rotated(vector, axis, degrees) {
  const angle = radians(degrees);
  const turned = addScaled(addScaled([0, 0, 0], vector, Math.cos(angle)), cross(axis, vector), Math.sin(angle));
  return addScaled(turned, axis, dot(axis, vector) * (1 - Math.cos(angle)));
}

function radians(degrees) {
  return (degrees * Math.PI) / 180;
}

/** @type {(camera: Camera) => Axes} */
export function cameraAxes(camera) {
  const forward = normalized(subtract(camera.focal_point, camera.position));
  const right = normalized(cross(forward, normalized(camera.view_up)));
  return {right, up: cross(right, forward), forward};
}

/** @type {(camera: Camera) => number} distance from the eye to the focal point, world units */
export function eyeDistance(camera) {
  return Math.hypot(...subtract(camera.focal_point, camera.position));
}

/** @type {(camera: Camera) => number} half the picture's height at the focal point, world units */
export function halfHeight(camera) {
  return camera.parallel_scale ?? eyeDistance(camera) * Math.tan(radians(camera.view_angle) / 2);
}

/** Rotate the eye about the focal point: to its right about view_up, then upwards; view_up turns with it, so that no
 * pole is special.
 * @type {(camera: Camera, azimuth: number, elevation: number) => Camera} angles in degrees */
export function orbit(camera, azimuth, elevation) {
  const {up, forward} = cameraAxes(camera);
  const back = rotated(addScaled([0, 0, 0], forward, -1), up, azimuth);
  const right = normalized(cross(up, back));
  const lifted = rotated(back, right, -elevation);
  const position = addScaled(camera.focal_point, lifted, eyeDistance(camera));
  return {...camera, position, view_up: cross(lifted, right)};
}

/** Rotate the camera clockwise about the direction of view. @type {(camera: Camera, degrees: number) => Camera} */
export function roll(camera, degrees) {
  const {up, forward} = cameraAxes(camera);
  return {...camera, view_up: rotated(up, forward, degrees)};
}

/** Move eye and focal point along the camera's axes.
 * @type {(camera: Camera, right: number, up: number, forward: number) => Camera} distances in world units */
export function travel(camera, right, up, forward) {
  const axes = cameraAxes(camera);
  const step = addScaled(addScaled(addScaled([0, 0, 0], axes.right, right), axes.up, up), axes.forward, forward);
  return {
    ...camera, position: addScaled(camera.position, step), focal_point: addScaled(camera.focal_point, step),
  };
}

/** Move the scene with the cursor. @type {(camera: Camera, dx: number, dy: number) => Camera}
 * dx, dy: to the right and down, as shares of the picture's height */
export function pan(camera, dx, dy) {
  const height = 2 * halfHeight(camera);
  return travel(camera, -dx * height, dy * height, 0);
}

/** Magnify about a point of the picture, which stays where it is at the depth of the focal point.
 * @type {(camera: Camera, factor: number, x?: number, y?: number) => Camera}
 * x, y: from the picture's centre to the right and down, as shares of its height */
export function zoom(camera, factor, x = 0, y = 0) {
  const shifted = pan(camera, x * (1 / factor - 1), y * (1 / factor - 1));
  if (camera.parallel_scale !== null) return {...shifted, parallel_scale: camera.parallel_scale / factor};
  const {forward} = cameraAxes(camera);
  return {...shifted, position: addScaled(shifted.focal_point, forward, -eyeDistance(camera) / factor)};
}

/** Turn the direction of view about the eye. @type {(camera: Camera, yaw: number, pitch: number) => Camera}
 * degrees to the right and up */
export function look(camera, yaw, pitch) {
  const {up, forward} = cameraAxes(camera);
  const turned = rotated(forward, up, -yaw);
  const right = normalized(cross(turned, up));
  const direction = rotated(turned, right, pitch);
  const focalPoint = addScaled(camera.position, direction, eyeDistance(camera));
  return {...camera, focal_point: focalPoint, view_up: cross(right, direction)};
}

/** Move eye and focal point so that a point is in the centre. @type {(camera: Camera, point: Vector) => Camera} */
export function centred(camera, point) {
  return {...camera, focal_point: point, position: addScaled(camera.position, subtract(point, camera.focal_point))};
}

/** Change between perspective and parallel projection; what lies at the focal point keeps its size.
 * @type {(camera: Camera) => Camera} */
export function otherProjection(camera) {
  if (camera.parallel_scale === null) return {...camera, parallel_scale: halfHeight(camera)};
  const {forward} = cameraAxes(camera);
  const distance = camera.parallel_scale / Math.tan(radians(camera.view_angle) / 2);
  return {...camera, parallel_scale: null, position: addScaled(camera.focal_point, forward, -distance)};
}

/** Look along a direction with all points in the picture.
 * @type {(camera: Camera, points: Vector[], aspect: number, toward?: Vector, up?: Vector) => Camera}
 * aspect: width / height; toward: from the scene to the eye; default: the present direction */
export function fitted(camera, points, aspect, toward, up) {
  const {centre, radius} = boundingSphere(points);
  const back = normalized(toward ?? subtract(camera.position, camera.focal_point));
  const viewUp = up ?? camera.view_up;
  const turned = {...camera, focal_point: centre, position: addScaled(centre, back, radius), view_up: viewUp};
  const axes = cameraAxes(turned);
  const tangent = Math.tan(radians(camera.view_angle) / 2);
  let distance = FIT_RADII * radius;
  let scale = 0;
  for (const point of points) {
    const offset = subtract(point, centre);
    const aside = Math.max(Math.abs(dot(offset, axes.right)) / aspect, Math.abs(dot(offset, axes.up)));
    scale = Math.max(scale, aside / (1 - FIT_MARGIN));
    distance = Math.max(distance, aside / (1 - FIT_MARGIN) / tangent - dot(offset, axes.forward));
  }
  const parallelScale = camera.parallel_scale === null ? null : scale || radius;
  return {...turned, view_up: axes.up, position: addScaled(centre, back, distance), parallel_scale: parallelScale};
}

/** @type {(points: Vector[]) => {centre: Vector, radius: number}} */
export function boundingSphere(points) {
  const axes = [0, 1, 2].map((axis) => points.map((point) => point[axis]));
  const centre = axes.map((values) => Math.min(...values) / 2 + Math.max(...values) / 2);
  const radius = Math.max(...points.map((point) => Math.hypot(...subtract(point, centre))));
  return {centre, radius: radius || Math.max(...centre.map((value) => Math.abs(value) * 2 ** -40)) || 1};
}

/** @type {(bounds: [Vector, Vector]) => Vector[]} the eight corners; bit a of the index: the upper end of axis a */
export function boxCorners(bounds) {
  return Array.from({length: 8}, (_, i) => [0, 1, 2].map((axis) => bounds[(i >> axis) & 1][axis]));
}

/** Direction to the eye and view_up of a named view.
 * @type {(name: string, orientation: string) => {toward: Vector, up: Vector, label: string}}
 * name: front, back, left, right, top, bottom; orientation: anatomical directions of x, y, z such as "RAS", or "" */
export function namedView(name, orientation) {
  const letters = orientation || DEFAULT_ORIENTATION;
  const sign = (found, letter) => (found === letter ? 1 : found === OPPOSITE_SIDES[letter] ? -1 : 0);
  const axis = (letter) => [...letters].map((found) => sign(found, letter));
  const side = EYE_SIDES[name];
  const up = "SI".includes(side) ? (orientation ? "A" : "P") : "S";
  const toward = axis(side);
  const index = toward.findIndex((value) => value !== 0);
  const label = orientation ? ANATOMICAL_NAMES[side] : `${toward[index] < 0 ? "−" : "+"}${"xyz"[index]}`;
  return {toward, up: axis(up), label};
}

/** Camera on the way from one to another: the direction turns evenly, the distance changes by a constant factor.
 * @type {(from: Camera, to: Camera, share: number) => Camera} share: 0 … 1 */
export function interpolateCamera(from, to, share) {
  if (share >= 1) return to;
  const {axis, degrees} = rotationBetween(cameraAxes(from), cameraAxes(to));
  const axes = cameraAxes(from);
  const forward = rotated(axes.forward, axis, share * degrees);
  const focalPoint = addScaled(from.focal_point, subtract(to.focal_point, from.focal_point), share);
  const distance = geometric(eyeDistance(from), eyeDistance(to), share);
  const bothParallel = from.parallel_scale !== null && to.parallel_scale !== null;
  return {
    position: addScaled(focalPoint, forward, -distance),
    focal_point: focalPoint,
    view_up: rotated(axes.up, axis, share * degrees),
    view_angle: from.view_angle + share * (to.view_angle - from.view_angle),
    parallel_scale: bothParallel ? geometric(from.parallel_scale, to.parallel_scale, share) : to.parallel_scale,
  };
}

function geometric(from, to, share) {
  return from * (to / from) ** share;
}

/** @type {(from: Axes, to: Axes) => {axis: Vector, degrees: number}} the rotation that turns one into the other */
function rotationBetween(from, to) {
  const pairs = [[from.right, to.right], [from.up, to.up], [from.forward, to.forward]];
  const entry = (row, column) => pairs.reduce((sum, [a, b]) => sum + b[row] * a[column], 0);
  const cosine = (entry(0, 0) + entry(1, 1) + entry(2, 2) - 1) / 2;
  const skew = [entry(2, 1) - entry(1, 2), entry(0, 2) - entry(2, 0), entry(1, 0) - entry(0, 1)].map((v) => v / 2);
  const angle = Math.atan2(Math.hypot(...skew), cosine);
  if (angle < 1e-9) return {axis: [0, 0, 1], degrees: 0};
  // The symmetric part is (1 − cos) · axis axisᵀ + cos · 1: its longest column is the axis, even at half a turn.
  const column = (k) => [0, 1, 2].map((i) => (entry(i, k) + entry(k, i)) / 2 - (i === k ? cosine : 0));
  const longest = [0, 1, 2].map(column).sort((a, b) => Math.hypot(...b) - Math.hypot(...a))[0];
  const axis = normalized(longest);
  const degrees = (angle * 180) / Math.PI;
  return {axis, degrees: dot(axis, skew) < 0 ? -degrees : degrees};
}

/** Project a point to pixels. @type {(camera: Camera, point: Vector, width: number, height: number) => Vector}
 * returns x and y from the top left corner, and the depth along the direction of view (world; not positive: behind) */
export function projected(camera, point, width, height) {
  const {right, up, forward} = cameraAxes(camera);
  const offset = subtract(point, camera.position);
  const ahead = dot(offset, forward);
  const half = camera.parallel_scale ?? ahead * Math.tan(radians(camera.view_angle) / 2);
  const scale = height / 2 / half;
  return [width / 2 + dot(offset, right) * scale, height / 2 - dot(offset, up) * scale, ahead];
}

/** Ray through a point of the picture. @type {(camera: Camera, x: number, y: number, width: number, height: number) =>
 * {origin: Vector, direction: Vector}} x, y: pixels from the top left corner; direction: unit */
export function pixelRay(camera, x, y, width, height) {
  const {right, up, forward} = cameraAxes(camera);
  const half = halfHeight(camera);
  const aside = ((x - width / 2) / (height / 2)) * half;
  const above = ((height / 2 - y) / (height / 2)) * half;
  const offset = addScaled(addScaled([0, 0, 0], right, aside), up, above);
  if (camera.parallel_scale !== null) return {origin: addScaled(camera.position, offset), direction: forward};
  return {origin: camera.position, direction: normalized(addScaled(offset, forward, eyeDistance(camera)))};
}

/** Position along an axis that is nearest to a ray.
 * @type {(ray: {origin: Vector, direction: Vector}, point: Vector, axis: Vector) => ?number}
 * axis: unit; returns the distance from the point, null where the ray is parallel to the axis */
export function nearestOnAxis(ray, point, axis) {
  const cosine = dot(ray.direction, axis);
  const sineSquared = 1 - cosine * cosine;
  if (sineSquared < 1e-6) return null;
  const offset = subtract(ray.origin, point);
  return (dot(offset, axis) - cosine * dot(offset, ray.direction)) / sineSquared;
}

/** Direction from a sphere's centre to where a ray meets it, or to the ray's nearest point.
 * @type {(ray: {origin: Vector, direction: Vector}, centre: Vector, radius: number) => Vector} unit */
export function directionOnSphere(ray, centre, radius) {
  const offset = subtract(ray.origin, centre);
  const nearest = -dot(offset, ray.direction);
  const aside = addScaled(offset, ray.direction, nearest);
  const depth = Math.sqrt(Math.max(0, radius * radius - dot(aside, aside)));
  return normalized(addScaled(aside, ray.direction, -depth));
}
