// Draws what the sensor sees, as events that fade or as a grey picture; the board as it moves, and where it should go.

const FADE = 0.09; // s until an event is at 1/e of its brightness
const LEAK = 0.2; // s until a change of brightness is at 1/e in the grey picture
const LIMIT = 6; // largest brightness of the grey picture, in OFF thresholds: hot pixels stay below
const LEVELS = 64; // of the histogram that sets the contrast of the grey picture
const CLIPPED = 0.02; // share of the pixels that are shown black, and the same share white
const SETTLE = 0.1; // share of a new contrast that a picture takes, so that the brightness does not flicker
const SHOWN = 0.5; // s after which a board that was not seen again is hidden
const FARTHEST = 1 / 60; // share of the picture's width that the board may have moved since it was seen; beyond, it is not known where it is
const CORNERS = ["1", "2", "3", "4"];
const SWING = 0.22; // how much larger and smaller the sides of a swinging ghost become
const SWING_TIME = 1600; // ms for one swing

function channels(color) {
  const hex = color.trim().slice(1);
  return [0, 2, 4].map((start) => parseInt(hex.slice(start, start + 2), 16));
}

export class Picture {
  constructor(canvas) {
    this.canvas = canvas;
    this.small = document.createElement("canvas");
    this.mirrored = false;
    this.isGrey = false;
    this.last = 0;
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    this.dark.addEventListener("change", () => this.readColors());
    this.readColors();
  }

  readColors() {
    const style = getComputedStyle(document.documentElement);
    const read = (name) => style.getPropertyValue(name);
    this.colors = { paper: read("--paper"), board: read("--board"), ghost: read("--ghost"), ink: read("--ink") };
    this.paper = channels(read("--paper"));
    this.on = channels(read("--on"));
    this.off = channels(read("--off"));
  }

  resize([width, height]) {
    if (this.small.width === width && this.small.height === height && this.image) return;
    this.small.width = width;
    this.small.height = height;
    this.image = this.small.getContext("2d").createImageData(width, height);
    this.level = new Float32Array(2 * width * height);
    this.clear();
  }

  // Forgets all events of the grey picture.
  clear() {
    this.brightness = new Float32Array(this.small.width * this.small.height);
    this.t = null;
    this.totals = [0, 0];
    this.range = null;
  }

  setGrey(isGrey) {
    this.isGrey = isGrey;
    if (this.image) this.clear();
  }

  draw(state, pixels) {
    this.resize(state.sensor);
    if (this.isGrey) this.integrate(pixels, state.t);
    else this.fade(pixels);
    const [width, height] = state.sensor;
    const scale = Math.max(1, Math.round((this.canvas.clientWidth * devicePixelRatio) / width * 4) / 4);
    const [wide, high] = [Math.round(width * scale), Math.round(height * scale)];
    if (this.canvas.width !== wide || this.canvas.height !== high) {
      this.canvas.width = wide;
      this.canvas.height = high;
    }
    const context = this.canvas.getContext("2d");
    context.setTransform(this.mirrored ? -scale : scale, 0, 0, scale, this.mirrored ? wide : 0, 0);
    context.imageSmoothingEnabled = false;
    context.drawImage(this.small, 0, 0);
    // A pixel's coordinates are those of its centre.
    context.translate(0.5, 0.5);
    const line = Math.max(1.6, width / 180);
    this.drawn = null;
    // While everything waits for a calibration the picture stands still.
    if (state.step) return;
    if (state.nothing) this.drawCircles(context, state.nothing.circles, [0, 0], line);
    if (state.phase !== "recording") return;
    if (state.ghost) this.drawGhost(context, state, line);
    if (state.board) this.drawBoard(context, state, line);
  }

  fade(pixels) {
    const now = performance.now() / 1000;
    const keep = Math.exp(-Math.min(1, now - this.last) / FADE);
    this.last = now;
    const { level, image: { data }, paper, on, off } = this;
    const count = level.length / 2;
    for (let index = 0; index < count; index += 1) {
      const byte = index < pixels.length ? pixels[index] : 0;
      let bright = level[2 * index] * keep;
      let dark = level[2 * index + 1] * keep;
      if (byte & 15) bright = 1;
      if (byte >> 4) dark = 1;
      level[2 * index] = bright;
      level[2 * index + 1] = dark;
      const [strength, color] = bright >= dark ? [bright, on] : [dark, off];
      for (let channel = 0; channel < 3; channel += 1) {
        data[4 * index + channel] = paper[channel] + strength * (color[channel] - paper[channel]);
      }
      data[4 * index + 3] = 255;
    }
    this.small.getContext("2d").putImageData(this.image, 0, 0);
  }

  // The sum of each pixel's events, with a leak, is its brightness. `t` is the sensor's time (s).
  integrate(pixels, t) {
    if (t < this.t) this.clear();
    const keep = Math.exp(-(t - (this.t ?? t)) / LEAK);
    this.t = t;
    const { brightness, totals, image: { data } } = this;
    // Over time a pixel becomes brighter by as much as darker.
    const weight = totals[0] && totals[1] ? totals[1] / totals[0] : 1;
    const counts = new Uint32Array(LEVELS);
    for (let index = 0; index < brightness.length; index += 1) {
      const byte = index < pixels.length ? pixels[index] : 0;
      const [on, off] = [byte & 15, byte >> 4];
      totals[0] += on;
      totals[1] += off;
      const value = keep * brightness[index] + weight * on - off;
      brightness[index] = Math.max(-LIMIT, Math.min(LIMIT, value));
      counts[Math.min(LEVELS - 1, Math.floor((brightness[index] / LIMIT + 1) / 2 * LEVELS))] += 1;
    }
    const [black, white] = this.contrast(counts);
    for (let index = 0; index < brightness.length; index += 1) {
      data.fill(255 * (brightness[index] - black) / (white - black), 4 * index, 4 * index + 3);
      data[4 * index + 3] = 255;
    }
    this.small.getContext("2d").putImageData(this.image, 0, 0);
  }

  // The brightness of black and of white, from a histogram of the picture.
  contrast(counts) {
    const share = CLIPPED * this.brightness.length;
    const first = (order) => {
      let sum = 0;
      return order.find((level) => (sum += counts[level]) > share);
    };
    const levels = [...counts.keys()];
    const [low, high] = [first(levels), first(levels.reverse()) + 1].map((level) => LIMIT * ((2 * level) / LEVELS - 1));
    // Noise alone does not fill the range.
    const range = [Math.min(low, -1), Math.max(high, 1)];
    this.range = (this.range ?? range).map((value, end) => value + SETTLE * (range[end] - value));
    return this.range;
  }

  path(context, points) {
    context.beginPath();
    points.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.closePath();
  }

  drawGhost(context, state, line) {
    const { ghost } = state;
    if (ghost.outline.length < 3) return;
    if (state.is_there && !this.still.matches) this.drawSwing(context, ghost, line);
    this.path(context, ghost.outline);
    context.fillStyle = this.colors.ghost;
    context.globalAlpha = 0.08 + 0.25 * ghost.gained;
    context.fill();
    context.globalAlpha = 1;
    context.strokeStyle = this.colors.ghost;
    context.lineWidth = 1.5 * line;
    context.setLineDash([4 * line, 3 * line]);
    context.stroke();
    context.setLineDash([]);
    if (ghost.corners.length === 4) this.drawCorners(context, ghost.corners, this.colors.ghost, line);
  }

  // The ghost as it swings: how the board is to be moved where it is.
  drawSwing(context, ghost, line) {
    const middle = [0, 1].map((axis) => ghost.outline.reduce((sum, point) => sum + point[axis], 0) / ghost.outline.length);
    const along = ghost.sideways ? 0 : 1;
    const across = 1 - along;
    const half = Math.max(1, ...ghost.outline.map((point) => Math.abs(point[along] - middle[along])));
    const turn = SWING * Math.sin((2 * Math.PI * performance.now()) / SWING_TIME);
    const turned = ghost.outline.map((point) => {
      const moved = [0, 0];
      moved[along] = middle[along] + (point[along] - middle[along]) * (1 - 0.5 * Math.abs(turn));
      // The side that comes nearer becomes larger.
      moved[across] = middle[across] + (point[across] - middle[across]) * (1 + (turn * (point[along] - middle[along])) / half);
      return moved;
    });
    this.path(context, turned);
    context.strokeStyle = this.colors.ghost;
    context.lineWidth = line;
    context.stroke();
  }

  drawBoard(context, state, line) {
    const { board } = state;
    const age = state.t - board.t;
    if (!(age < SHOWN)) return;
    const ahead = Math.max(0, age);
    const moved = board.corners.map(([x, y], index) => {
      const [vx, vy] = board.velocity[index];
      return [x + ahead * vx, y + ahead * vy];
    });
    const farthest = Math.max(...moved.map(([x, y], index) => Math.hypot(x - board.corners[index][0], y - board.corners[index][1])));
    if (farthest > FARTHEST * state.sensor[0]) return;
    this.drawn = farthest;
    const shift = [0, 1].map((axis) => moved.reduce((sum, corner, index) => sum + corner[axis] - board.corners[index][axis], 0) / 4);
    context.strokeStyle = this.colors.board;
    context.lineWidth = line;
    this.path(context, moved);
    context.stroke();
    this.drawCircles(context, board.circles, shift, line);
    this.drawCorners(context, moved, this.colors.board, line);
  }

  drawCircles(context, circles, [right, down], line) {
    context.strokeStyle = this.colors.board;
    context.lineWidth = 0.6 * line;
    for (const [x, y, radius] of circles) {
      context.beginPath();
      context.arc(x + right, y + down, radius, 0, 2 * Math.PI);
      context.stroke();
    }
  }

  // The same numbers on the board and on its ghost: which corner goes where.
  drawCorners(context, corners, color, line) {
    context.font = `bold ${7 * line}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    corners.forEach(([x, y], index) => {
      context.fillStyle = color;
      context.beginPath();
      context.arc(x, y, 4.6 * line, 0, 2 * Math.PI);
      context.fill();
      context.save();
      context.translate(x, y);
      if (this.mirrored) context.scale(-1, 1);
      context.fillStyle = this.colors.paper;
      context.fillText(CORNERS[index], 0, 0.4 * line);
      context.restore();
    });
  }
}
