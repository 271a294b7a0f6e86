/**
 * The canvas that shows pictures. A new picture replaces the old one when it is decoded, so that nothing flashes.
 *
 * @typedef {{kind: string, picture: number, revision: number, input: number, still: boolean, width: number,
 *   height: number, format: string, camera: import("./camera.js").Camera, seconds: number}} PictureHeader
 * @typedef {{left: number, top: number, width: number, height: number}} Rectangle
 */

/** Relative difference of aspect ratios below which a picture fills the canvas: sizes while moving are rounded. */
const ASPECT_TOLERANCE = 0.02;

/** Greys behind transparent pictures; their mean is the grey behind pictures that move. */
const CHECKERBOARD = ["#6f6f6f", "#909090"];
const CHECKER_PIXELS = 12;

function drawCheckerboard(context, left, top, width, height) {
  const tile = new OffscreenCanvas(2 * CHECKER_PIXELS, 2 * CHECKER_PIXELS);
  const tileContext = tile.getContext("2d");
  for (const [column, row] of [[0, 0], [0, 1], [1, 0], [1, 1]]) {
    tileContext.fillStyle = CHECKERBOARD[(column + row) % 2];
    tileContext.fillRect(column * CHECKER_PIXELS, row * CHECKER_PIXELS, CHECKER_PIXELS, CHECKER_PIXELS);
  }
  context.fillStyle = context.createPattern(tile, "repeat");
  context.fillRect(left, top, width, height);
}

/** Split a binary message. @type {(data: ArrayBuffer | ArrayBufferView) => {header: object, payload: Uint8Array}} */
export function parseBinary(data) {
  const bytes = ArrayBuffer.isView(data)
    ? new Uint8Array(data.buffer, data.byteOffset, data.byteLength) : new Uint8Array(data);
  const length = new DataView(bytes.buffer, bytes.byteOffset).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
  return {header, payload: bytes.subarray(4 + length)};
}

/** Decodes pictures beside the main thread and draws the newest one. */
export class PictureCanvas {
  /** @param {HTMLCanvasElement} canvas @param {(header: PictureHeader) => void} shown called after each drawing
   * @param {(header: PictureHeader) => void} done called when a picture is shown, or dropped for a newer one */
  constructor(canvas, shown, done) {
    this.canvas = canvas;
    this.shown = shown;
    this.done = done;
    /** @type {?PictureHeader} */
    this.header = null;
    this.bitmap = null;
  }

  /** Show a picture unless a newer one is there by then.
   * @type {(header: PictureHeader, payload: Uint8Array) => Promise<void>} */
  async show(header, payload) {
    const file = new Blob([payload], {type: `image/${header.format}`});
    const bitmap = await createImageBitmap(file, {colorSpaceConversion: "none"}).finally(() => this.done(header));
    if (this.header && header.picture < this.header.picture) {
      bitmap.close();
      return;
    }
    this.bitmap?.close();
    this.bitmap = bitmap;
    this.header = header;
    this.draw();
    this.shown(header);
  }

  /** Change the canvas's size, device pixels. @type {(width: number, height: number) => void} */
  resize(width, height) {
    this.canvas.width = width;
    this.canvas.height = height;
    this.draw();
  }

  /** Forget the number of the shown picture: a new session counts from its own first one. */
  restart() {
    if (this.header) this.header = {...this.header, picture: -1};
  }

  draw() {
    if (!this.bitmap) return;
    const context = this.canvas.getContext("2d");
    const {left, top, width, height} = this.rectangle();
    context.imageSmoothingEnabled = width !== this.bitmap.width || height !== this.bitmap.height;
    context.imageSmoothingQuality = "high";
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    if (this.header.format === "png") drawCheckerboard(context, left, top, width, height);
    context.drawImage(this.bitmap, left, top, width, height);
  }

  /** Part of the canvas that the picture fills, device pixels. @type {() => Rectangle} */
  rectangle() {
    const {width, height} = this.canvas;
    const aspect = this.header ? this.header.width / this.header.height : width / height;
    if (Math.abs((aspect * height) / width - 1) < ASPECT_TOLERANCE) return {left: 0, top: 0, width, height};
    const scale = Math.min(width / aspect, height);
    const [fittedWidth, fittedHeight] = [Math.round(scale * aspect), Math.round(scale)];
    return {
      left: Math.round((width - fittedWidth) / 2), top: Math.round((height - fittedHeight) / 2),
      width: fittedWidth, height: fittedHeight,
    };
  }
}
