// Everything beside the picture: hint, ring, coverage, figures, result.

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
  if (state.phase === "calibrating") return "calibrating …";
  if (state.phase === "done") return "done";
  if (state.phase === "failed") return "no calibration";
  return mirrored ? state.hint.mirrored : state.hint.plain;
}

function showCells(coverage) {
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
  coverage.cells.forEach((share, index) => svg.children[index].setAttribute("fill-opacity", (0.06 + 0.94 * share).toFixed(2)));
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
  if (outcome.report) {
    byId("open-report").href = outcome.report;
    byId("report").src = outcome.report;
  }
}

export function show(state, mirrored) {
  const isOver = ["calibrating", "done", "failed"].includes(state.phase);
  document.body.dataset.phase = state.phase;
  setText(byId("hint"), hintOf(state, mirrored));
  const { progress } = state;
  byId("ring").querySelector(".fill").setAttribute("stroke-dasharray", `${100 * progress} 100`);
  setText(byId("percent"), percent(progress));
  const isEnough = state.missing.length === 0;
  setText(byId("missing-title"), isEnough ? "Nothing is missing" : isOver ? "Ended before it saw" : "Still wanted");
  setList(byId("missing"), state.missing);
  byId("sight").hidden = isOver && state.phase !== "calibrating";
  byId("finish").hidden = isOver;
  byId("mirror").hidden = isOver;
  byId("sound").hidden = isOver;
  showCells(state.coverage);
  setText(byId("covered"), `${percent(state.coverage.covered)} of the sensor, ${state.coverage.boards} boards`);
  setPairs(byId("tilts"), state.coverage.tilts.map(({ name, count }) => [`${name} nearer`, String(count)]));
  setPairs(byId("distances"), state.coverage.distances.map(({ name, count }) => [name, String(count)]));
  const { health } = state;
  const known = (value, text) => (value === null ? "–" : text(value));
  setPairs(byId("health"), [
    ["event rate", `${(health.rate / 1e6).toFixed(2)} Mev/s`],
    ["busiest, of the camera's limit", known(health.load, percent)],
    ["ON events", known(health.on_share, percent)],
    ["noise of a pixel at rest", known(health.noise, (rate) => `${rate.toFixed(1)} Hz`)],
    ["hot pixels", known(health.hot_pixels, String)],
    ["flicker", known(health.flicker, (frequency) => (frequency ? `${frequency} Hz` : "none"))],
    ["edges, sharpest", known(health.focus, ([width, sharpest]) => `${width.toFixed(1)}, ${sharpest.toFixed(1)} px`)],
    ["lost by the camera", known(health.dropped, String)],
    ["transfers not displayed", String(health.not_shown)],
    ["time", `${state.t.toFixed(1)} s`],
  ]);
  setText(byId("nothing"), !isOver && state.nothing ? state.nothing.reason : "");
  const [fx, fy, cx, cy] = state.camera ?? [];
  const { checkpoint } = state;
  const pixels = (value) => (value === null || value === undefined ? "–" : `± ${value.toFixed(3)} px`);
  setPairs(byId("estimate"), [
    [checkpoint ? `stated after ${checkpoint.t.toFixed(0)} s` : "stated", checkpoint?.failed ? "no calibration" : pixels(checkpoint?.stated)],
    ["largest stated", pixels(checkpoint?.largest)],
    ["two halves agree", !checkpoint || checkpoint.failed ? "–" : checkpoint.halves_agree ? "yes" : "no"],
    ["now, about", pixels(state.about)],
    ["wanted", `± ${state.target} px`],
    ["calibrating now", state.checkpoint_under_way === null ? "–" : `the first ${state.checkpoint_under_way.toFixed(0)} s`],
    ["from windows alone", pixels(state.sigma)],
    ["focal lengths", state.camera ? `${fx.toFixed(1)}, ${fy.toFixed(1)} px` : "–"],
    ["principal point", state.camera ? `${cx.toFixed(1)}, ${cy.toFixed(1)} px` : "–"],
  ]);
  showOutcome(state);
}
