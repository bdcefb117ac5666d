// All parts of the page but the picture: hint, ring, coverage, figures, result.

const byId = (id) => document.getElementById(id);
const percent = (share) => `${Math.round(100 * share)} %`;

function setText(element, text) {
  // Writing the same again would be read aloud again.
  if (element.textContent !== text) element.textContent = text;
}

function setList(list, texts) {
  const joined = texts.join("\n");
  if (list.dataset.shown === joined) return;
  list.dataset.shown = joined;
  list.replaceChildren(...texts.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
}

function setPairs(list, pairs) {
  const joined = JSON.stringify(pairs);
  if (list.dataset.shown === joined) return;
  list.dataset.shown = joined;
  list.replaceChildren(
    ...pairs.flatMap(([name, value]) => [
      Object.assign(document.createElement("dt"), { textContent: name }),
      Object.assign(document.createElement("dd"), { textContent: value }),
    ]),
  );
}

function hintOf(state, mirrored) {
  if (state.phase === "calibrating" || (state.step && !state.outcome)) return "calibrating …";
  if (state.phase === "done") return state.outcome?.is_target_met ? "done" : endedAs(state);
  if (state.phase === "failed") return "no calibration";
  return mirrored ? state.hint.mirrored : state.hint.plain;
}

// The heading of a session that ended without its target.
function endedAs({ outcome, target, missing }) {
  const sigma = outcome?.sigma ?? 0;
  if (sigma <= target) return `ended: ${missing.plain.length ? "some views are missing" : "not good enough"}`;
  return `ended: ± ${sigma.toFixed(3)} px, target ± ${target}`;
}

function showStep(state) {
  const { step } = state;
  byId("step").hidden = !step || Boolean(state.outcome);
  if (byId("step").hidden) return;
  setText(byId("step-text"), step.text || "beginning");
  const bar = byId("step-bar");
  if (step.done === null) bar.removeAttribute("value");
  else bar.value = 100 * step.done;
}

// The colour of a cell: blue if its error is the target or less, orange from ten times the target, equal steps for equal ratios.
const MOST = 10;
function shade(sigma, target) {
  if (sigma === null || sigma === undefined) return "var(--faint)";
  const share = Math.min(1, Math.max(0, Math.log(sigma / target) / Math.log(MOST)));
  return `color-mix(in srgb, var(--off) ${Math.round(100 * share)}%, var(--on))`;
}

function showCells({ coverage, target, checkpoint }) {
  const svg = byId("cells");
  const count = coverage.columns * coverage.rows;
  if (svg.childElementCount !== count) {
    svg.setAttribute("viewBox", `0 0 ${coverage.columns * 10} ${coverage.rows * 10}`);
    const cells = Array.from({ length: count }, (_, index) => {
      const cell = document.createElementNS("http://www.w3.org/2000/svg", "rect");
      cell.setAttribute("x", 10 * (index % coverage.columns));
      cell.setAttribute("y", 10 * Math.floor(index / coverage.columns));
      cell.setAttribute("width", 10);
      cell.setAttribute("height", 10);
      return cell;
    });
    svg.replaceChildren(...cells);
  }
  const hasSigma = coverage.sigma.length === count;
  coverage.cells.forEach((share, index) => {
    const cell = svg.children[index];
    cell.setAttribute("fill-opacity", (0.08 + 0.92 * share).toFixed(2));
    cell.style.fill = hasSigma ? shade(coverage.sigma[index], target) : "";
  });
  byId("shades").hidden = !hasSigma;
  const known = coverage.sigma.filter((sigma) => sigma !== null);
  if (!known.length) return;
  const range = [Math.min(...known), Math.max(...known)].map((sigma) => sigma.toFixed(3)).join(" to ");
  setText(byId("shade-range"), `now ± ${range} px${checkpoint?.stated ? "" : ", quick estimate"}; pale: not covered`);
}

const figure = (value) => (Number.isInteger(value) ? String(value) : Math.abs(value) >= 10 ? value.toFixed(3) : value.toPrecision(6));

export function kAndD(outcome) {
  const rows = outcome.matrix.map((row) => `[${row.map(figure).join(", ")}]`);
  return { matrix: `[${rows.join(",\n ")}]`, distortion: `[${outcome.distortion.map(figure).join(", ")}]` };
}

function showOutcome(state) {
  const { outcome } = state;
  byId("result").hidden = !outcome;
  // An outcome comes in many states, and after another recording there is none for a while.
  const key = outcome ? JSON.stringify(outcome) : "";
  if (byId("result").dataset.shown === key) return;
  byId("result").dataset.shown = key;
  byId("copied").textContent = "";
  if (!outcome) return;
  byId("again").hidden = !outcome.can_record;
  byId("add").hidden = !outcome.can_record;
  setText(byId("verdict"), outcome.verdict);
  const sigma = outcome.sigma === null ? "" : `, projection ± ${outcome.sigma.toFixed(3)} px`;
  const hasCamera = outcome.distortion.length + outcome.matrix[0][0] > 0;
  setText(byId("facts"), hasCamera ? `${outcome.model}${sigma}. Written to ${outcome.folder}.` : "");
  const { matrix, distortion } = kAndD(outcome);
  setText(byId("matrix"), matrix);
  setText(byId("distortion"), distortion);
  document.querySelector(".numbers").hidden = !hasCamera;
  byId("copy").hidden = !hasCamera;
  byId("open-report").hidden = !outcome.report;
  byId("report").hidden = !outcome.report;
  showFiles(outcome.files);
  if (outcome.report) {
    byId("open-report").href = outcome.report;
    byId("report").src = outcome.report;
  }
}

function showFiles(files) {
  byId("files-title").hidden = files.length === 0;
  byId("files").replaceChildren(...files.map(({ name, path }) => {
    const item = document.createElement("li");
    const link = Object.assign(document.createElement("a"), { textContent: name, href: path, target: "_blank", rel: "noopener" });
    item.append(link);
    return item;
  }));
}

export function show(state, mirrored) {
  const side = mirrored ? "mirrored" : "plain";
  document.body.dataset.mirrored = String(mirrored);
  const isOver = ["calibrating", "done", "failed"].includes(state.phase);
  const isMet = state.phase === "done" && Boolean(state.outcome?.is_target_met);
  // Nobody is ordered about while everything waits for a calibration.
  const waits = Boolean(state.step) && !state.outcome;
  document.body.dataset.phase = state.phase;
  document.body.dataset.met = String(isMet);
  showStep(state);
  setText(byId("hint"), hintOf(state, mirrored));
  const { progress } = state;
  const gained = state.ghost && !waits ? state.ghost.gained : null;
  byId("ring").querySelector(".fill").setAttribute("stroke-dasharray", `${100 * (gained ?? 0)} 100`);
  setText(byId("gained"), gained === null ? "–" : percent(gained));
  byId("ring").toggleAttribute("hidden", isOver || waits);
  byId("total").parentElement.hidden = isOver || waits;
  byId("total").value = 100 * progress;
  setText(byId("percent"), percent(progress));
  // What was not seen was not needed where the target was met.
  const missing = isMet ? [] : state.missing[side];
  byId("missing").hidden = waits;
  byId("missing-title").hidden = waits;
  const isEnough = missing.length === 0;
  setText(byId("missing-title"), isEnough ? "Nothing is missing" : isOver ? "Missing" : "Still missing");
  setList(byId("missing"), missing);
  byId("sight").hidden = isOver && state.phase !== "calibrating";
  byId("finish").hidden = isOver;
  byId("mirror").hidden = isOver;
  byId("sound").hidden = isOver;
  byId("frames").hidden = isOver || !state.has_frames;
  showCells(state);
  byId("before").hidden = state.before === 0;
  setText(byId("before"), `With ${state.before === 1 ? "the recording" : `the ${state.before} recordings`} before.`);
  setText(byId("covered"), `${percent(state.coverage.covered)} of the sensor, ${state.coverage.boards} boards`);
  setPairs(byId("tilts"), state.coverage.tilts.map((tilt) => [`${mirrored ? tilt.mirrored : tilt.name} nearer`, String(tilt.count)]));
  setPairs(byId("distances"), state.coverage.distances.map(({ name, count }) => [name, String(count)]));
  const { health } = state;
  const known = (value, text) => (value === null ? "–" : text(value));
  setPairs(byId("health"), [
    ["event rate", `${(health.rate / 1e6).toFixed(2)} Mev/s`],
    ["peak rate, share of the limit", known(health.load, percent)],
    ["ON events", known(health.on_share, percent)],
    ["noise of a pixel at rest", known(health.noise, (rate) => `${rate.toFixed(1)} Hz`)],
    ["hot pixels", known(health.hot_pixels, String)],
    ["flicker", known(health.flicker, (frequency) => (frequency ? `${frequency} Hz` : "none"))],
    ["edge width: now, best of 5 s", known(health.focus, ([width, sharpest]) => `${width.toFixed(1)}, ${sharpest.toFixed(1)} px`)],
    ["lost by the camera", known(health.dropped, String)],
    ["transfers not searched, not drawn", `${health.not_searched}, ${health.not_drawn}`],
    ["time", `${state.t.toFixed(1)} s`],
  ]);
  setText(byId("nothing"), !isOver && !waits && state.nothing ? state.nothing.reason : "");
  const [fx, fy, cx, cy] = state.camera ?? [];
  const { checkpoint } = state;
  const pixels = (value) => (value === null || value === undefined ? "–" : `± ${value.toFixed(3)} px`);
  setPairs(byId("estimate"), [
    [checkpoint ? `checkpoint at ${checkpoint.t.toFixed(0)} s` : "checkpoint", checkpoint?.failed ? "no calibration" : pixels(checkpoint?.stated)],
    ["largest at any position", pixels(checkpoint?.largest)],
    ["two halves agree", !checkpoint || checkpoint.failed ? "–" : checkpoint.halves_agree ? "yes" : "no"],
    ["now, estimated", pixels(state.about)],
    ["target", `± ${state.target} px`],
    ["checkpoint in progress", state.checkpoint_under_way === null ? "–" : `the first ${state.checkpoint_under_way.toFixed(0)} s`],
    ["quick estimate", pixels(state.sigma)],
    ["focal lengths", state.camera ? `${fx.toFixed(1)}, ${fy.toFixed(1)} px` : "–"],
    ["principal point", state.camera ? `${cx.toFixed(1)}, ${cy.toFixed(1)} px` : "–"],
  ]);
  showOutcome(state);
}
