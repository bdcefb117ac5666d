// Asks for the newest state, draws it, asks again: a slow browser gets fewer states, and nothing piles up.

import { Picture } from "/picture.js";
import { kAndD, show } from "/panels.js";

const byId = (id) => document.getElementById(id);
const token = location.hash.slice(1);
const headers = { "X-Evcal-Token": token };
const picture = new Picture(byId("picture"));
const decoder = new TextDecoder();
const pause = (seconds) => new Promise((resolve) => setTimeout(resolve, 1000 * seconds));

// For tests, and for whoever wants to look.
const page = { number: 0, shown: 0, skipped: 0, phase: "", hint: "", state: null, ages: [], outlines: [], outlined: null, drawn: null };
const MOST_AGES = 1000;
window.evcal = page;

function command(name) {
  return fetch(`/${name}`, { method: "POST", headers }).catch(() => {});
}

// What the person chose stays when the page is loaded again.
const chosen = {
  get: (name) => sessionStorage.getItem(`evcal-${name}`),
  set: (name, value) => sessionStorage.setItem(`evcal-${name}`, String(value)),
};

let audio = null;
function tone(frequency, seconds, delay = 0) {
  if (!audio) return;
  const [source, gain] = [audio.createOscillator(), audio.createGain()];
  const start = audio.currentTime + delay;
  source.frequency.value = frequency;
  gain.gain.setValueAtTime(0.2, start);
  gain.gain.exponentialRampToValueAtTime(0.001, start + seconds);
  source.connect(gain).connect(audio.destination);
  source.start(start);
  source.stop(start + seconds);
}

let nearest = 0;
let lastNearer = 0;

// The nearer the board is to the ghost, the higher: one note whenever it came nearer.
function nearer(ghost, isNew) {
  if (isNew) nearest = Infinity;
  if (ghost.distance === null || performance.now() - lastNearer < 250) return;
  if (ghost.distance < 0.9 * nearest && ghost.distance > 1) {
    if (nearest < Infinity) tone(440 * 2 ** (1.2 / ghost.distance), 0.12);
    lastNearer = performance.now();
  }
  nearest = Math.min(nearest, Math.max(ghost.distance, 0.5));
}

function sound(before, state) {
  if (!before) return;
  const isLost = (one) => one.hint.plain === "bring the board back";
  const has = (phase) => state.phase === phase && before.phase !== phase;
  if (has("done") && state.outcome?.is_target_met) [523, 659, 784].forEach((note, index) => tone(note, 0.8, 0.15 * index));
  else if (has("done") || has("failed")) [330, 233].forEach((note, index) => tone(note, 0.6, 0.25 * index));
  else if (state.phase !== "recording") return;
  else if (isLost(state) && !isLost(before)) tone(150, 0.5);
  else if (state.used_up > before.used_up) [659, 784].forEach((note) => tone(note, 0.3));
  else if (state.is_there && !before.is_there) tone(1047, 0.2);
  if (state.ghost) nearer(state.ghost, JSON.stringify(before.ghost?.corners) !== JSON.stringify(state.ghost.corners));
}

function note(ages, age) {
  ages.push(age);
  if (ages.length > MOST_AGES) ages.shift();
}

function take(buffer) {
  const view = new DataView(buffer);
  const length = view.getUint32(0, true);
  const number = view.getUint32(4, true);
  const state = JSON.parse(decoder.decode(new Uint8Array(buffer, 8, length)));
  const [width, height] = state.sensor;
  const pixels = new Uint8Array(buffer, 8 + length);
  const frame = state.frame && pixels.subarray(width * height);
  if (page.state === null) {
    setMirrored(chosen.get("mirrored") === null ? state.mirrored : chosen.get("mirrored") === "true");
    setGrey(chosen.get("grey") === "true");
  }
  sound(page.state, state);
  page.skipped += page.number ? Math.max(0, number - page.number - 1) : 0;
  Object.assign(page, { number, phase: state.phase, state });
  picture.draw(state, pixels);
  page.drawn = picture.drawn;
  showFrame(state, frame);
  show(state, picture.mirrored);
  page.hint = byId("hint").textContent;
  page.shown += 1;
  // How old the state was when it was drawn (ms), by the computer's clock, which server and page share.
  note(page.ages, Date.now() - state.made);
  // How long ago the events of a board were when its outline was first drawn (ms).
  if (state.board && state.board.t !== page.outlined) {
    page.outlined = state.board.t;
    note(page.outlines, Date.now() - state.made + 1000 * (state.t - state.board.t));
  }
}

function showHint(text) {
  if (!["done", "failed"].includes(page.phase)) byId("hint").textContent = text;
}

async function run() {
  if (!/^[0-9a-f]{32}$/.test(token)) {
    showHint("open the whole address that evcal printed");
    return;
  }
  for (;;) {
    try {
      const answer = await fetch(`/live?after=${page.number}`, { headers });
      if (answer.status === 200) take(await answer.arrayBuffer());
      else if (answer.status === 403) return showHint("this address is of an earlier run");
      else if (answer.status !== 204) await pause(0.5);
    } catch {
      showHint("evcal has ended");
      await pause(0.5);
    }
  }
}

function setMirrored(mirrored) {
  picture.mirrored = mirrored;
  byId("mirror").setAttribute("aria-pressed", String(mirrored));
}

function toggleMirror() {
  setMirrored(!picture.mirrored);
  chosen.set("mirrored", picture.mirrored);
}

function setGrey(isGrey) {
  picture.setGrey(isGrey);
  document.body.dataset.grey = String(isGrey);
  byId("grey").setAttribute("aria-pressed", String(isGrey));
}

function toggleGrey() {
  setGrey(!picture.isGrey);
  chosen.set("grey", picture.isGrey);
}

// The server knows whether frames are shown: all pages show the same, also after they were loaded again.
function toggleFrames() {
  command("frames");
}

function showFrame(state, pixels) {
  const isOver = !["waiting", "recording"].includes(state.phase);
  byId("frames").setAttribute("aria-pressed", String(state.shows_frames));
  byId("frame").hidden = isOver || !state.frame;
  byId("no-frame").hidden = isOver || !state.shows_frames || Boolean(state.frame);
  if (byId("frame").hidden) return;
  const [width, height] = state.frame;
  const canvas = byId("frame");
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  const image = context.createImageData(width, height);
  for (let index = 0; index < width * height; index += 1) {
    image.data.fill(pixels[index], 4 * index, 4 * index + 3);
    image.data[4 * index + 3] = 255;
  }
  context.putImageData(image, 0, 0);
}

function toggleSound() {
  if (audio) audio.close();
  audio = audio ? null : new AudioContext();
  byId("sound").setAttribute("aria-pressed", String(Boolean(audio)));
  tone(880, 0.2);
}

async function copy() {
  const { matrix, distortion } = kAndD(page.state.outcome);
  const text = `K = ${matrix}\nD = ${distortion}`;
  const copied = await navigator.clipboard.writeText(text).then(() => true, () => false);
  byId("copied").textContent = copied ? "Copied." : "The browser does not allow it: select the numbers above.";
}

byId("finish").addEventListener("click", () => command("finish"));
byId("mirror").addEventListener("click", toggleMirror);
byId("grey").addEventListener("click", toggleGrey);
byId("sound").addEventListener("click", toggleSound);
byId("frames").addEventListener("click", toggleFrames);
byId("copy").addEventListener("click", copy);
// A button that was clicked with the mouse gives the keys back; one that was reached with the keyboard keeps them.
addEventListener("click", (event) => {
  if (event.detail > 0) event.target.closest("button")?.blur();
});
for (const name of ["close", "again", "add"]) byId(name).addEventListener("click", () => command(name));
addEventListener("keydown", (event) => {
  if (event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
  // Space and Enter are those of a focused button.
  const isOfButton = [" ", "Enter"].includes(event.key) && event.target.closest("button, a, iframe");
  if (isOfButton) return;
  const key = event.key.toLowerCase();
  if (key === " ") toggleMirror();
  else if (key === "g") toggleGrey();
  else if (key === "s") toggleSound();
  else if (key === "f" && !byId("frames").hidden) toggleFrames();
  else if (event.key === "Enter" && ["waiting", "recording"].includes(page.phase)) command("finish");
  else if (event.key === "Enter" && !byId("open-report").hidden) byId("open-report").click();
  else return;
  event.preventDefault();
});
run();
