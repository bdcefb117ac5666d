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
const page = { number: 0, shown: 0, skipped: 0, phase: "", hint: "", state: null, ages: [], outlines: [], outlined: null };
const MOST_AGES = 1000;
window.evcal = page;

function command(name) {
  return fetch(`/${name}`, { method: "POST", headers }).catch(() => {});
}

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

function sound(before, state) {
  if (!before) return;
  const was = before.hint.plain;
  const is = state.hint.plain;
  if (state.phase === "done" && before.phase !== "done") [523, 659, 784].forEach((note, index) => tone(note, 0.8, 0.15 * index));
  else if (was === is) return;
  else if (is === "bring the board back") tone(150, 0.5);
  else if (is === "keep moving here") tone(880, 0.2);
  else if (was === "keep moving here") [659, 784].forEach((note) => tone(note, 0.3));
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
  const pixels = new Uint8Array(buffer, 8 + length);
  sound(page.state, state);
  page.skipped += page.number ? Math.max(0, number - page.number - 1) : 0;
  Object.assign(page, { number, phase: state.phase, state });
  picture.draw(state, pixels);
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

function tell(text) {
  if (!["done", "failed"].includes(page.phase)) byId("hint").textContent = text;
}

async function run() {
  if (!/^[0-9a-f]{32}$/.test(token)) {
    tell("open the whole address that evcal printed");
    return;
  }
  for (;;) {
    try {
      const answer = await fetch(`/live?after=${page.number}`, { headers });
      if (answer.status === 200) take(await answer.arrayBuffer());
      else if (answer.status === 403) return tell("this address is of an earlier run");
      else if (answer.status !== 204) await pause(0.5);
    } catch {
      tell("evcal has ended");
      await pause(0.5);
    }
    await new Promise((resolve) => setTimeout(resolve, 0));
  }
}

function toggleMirror() {
  picture.mirrored = !picture.mirrored;
  byId("mirror").setAttribute("aria-pressed", String(picture.mirrored));
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
byId("sound").addEventListener("click", toggleSound);
byId("copy").addEventListener("click", copy);
for (const name of ["close", "again", "add"]) byId(name).addEventListener("click", () => command(name));
addEventListener("keydown", (event) => {
  // A key that a focused button takes is that button's.
  if (event.repeat || event.ctrlKey || event.metaKey || event.altKey || event.target.closest("button, a, iframe")) return;
  if (event.key === " ") toggleMirror();
  else if (event.key === "s") toggleSound();
  else if (event.key === "Enter" && ["waiting", "recording"].includes(page.phase)) command("finish");
  else if (event.key === "Enter" && !byId("open-report").hidden) byId("open-report").click();
  else return;
  event.preventDefault();
});
run();
