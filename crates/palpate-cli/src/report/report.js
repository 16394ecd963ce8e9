// Draws the figures of the report from the JSON beside it. data.rs describes the numbers; only
// errors, which are norms, are computed here.

const DASHES = { ekf: "dash", uniform: "dot", knn: "dashdot" };

const touch = () => data.touches[chosen("touch")];
const colour = (method) => data.colours[data.methods.indexOf(method)] ?? INK;

// In a narrow window the buttons of a plot would lie on its legend.
const flat = { ...config, displayModeBar: window.innerWidth < 700 ? false : "hover" };
const axis = (title, more) => ({
  title: { text: title, standoff: 8 },
  gridcolor: FAINT,
  zerolinecolor: "#c4c9d2",
  linecolor: GREY,
  ticks: "outside",
  tickcolor: GREY,
  automargin: true,
  ...more,
});

// Curves.

/** Torques of one joint, N·m; a gap where they are not finite. */
const torques = (row = []) => row.map((tau) => (tau === null ? null : tau / data.per_torque));

/** ‖a − b‖₂ over the joints, by frame; `b` may be left out. */
const norms = (a, b) =>
  touch().time.map((_, frame) => {
    let squares = 0;
    for (let joint = 0; joint < a.length; joint += 1) {
      const from = b === undefined ? 0 : b[joint][frame];
      if (a[joint][frame] === null || from === null) return null;
      squares += ((a[joint][frame] - from) / data.per_torque) ** 2;
    }
    return Math.sqrt(squares);
  });
const errorOf = (method) => norms(touch().predicted[method], touch().external);

const timeTitle = () => (touch().counted ? "frame" : "time [s]");
const here = () => touch().time[chosen("frame")];

const curve = (name, y, line, more) => ({
  x: touch().time,
  y,
  name,
  line,
  hovertemplate: "%{y:.3f} N·m",
  ...more,
});

/** A thin line at the frame in which the 3-D view shows the arm. */
function marker() {
  if (!data.scene || touch().time.length === 0) return [];
  const line = { color: GREY, width: 1, dash: "dot" };
  return [{ type: "line", x0: here(), x1: here(), y0: 0, y1: 1, yref: "paper", line }];
}

function drawError() {
  const torque = curve("zero (‖τ‖₂)", norms(touch().external), { color: "#a9aeb8", width: 1 });
  const errors = data.methods.map((method, at) => {
    const width = at === data.subject ? 2.4 : 1.5;
    const line = { color: colour(method), dash: DASHES[method] ?? "solid", width };
    return curve(method, errorOf(at), line);
  });
  const curves = [torque, ...errors.filter(({ name }) => name !== "zero")];
  Plotly.react(
    "error",
    curves,
    layout({
      xaxis: axis(timeTitle()),
      yaxis: axis("error [N·m]", { rangemode: "tozero" }),
      shapes: marker(),
    }),
    flat,
  );
}

/** A band around the predicted torque of a joint. */
function bandTraces(predicted = [], halfWidth = [], shade) {
  const edge = (side) =>
    torques(predicted.map((tau, at) => (tau === null ? null : tau + side * halfWidth[at])));
  const none = { width: 0 };
  const quiet = { hoverinfo: "skip", hovertemplate: undefined };
  return [
    curve("", edge(-1), none, quiet),
    curve("band", edge(1), none, { ...quiet, fill: "tonexty", fillcolor: shade }),
  ];
}

function drawJoints() {
  const { external } = touch();
  const method = data.methods[chosen("method")];
  const predicted = touch().predicted[chosen("method")] ?? [];
  const halfWidth = touch().half_width[chosen("method")];
  const edges = (halfWidth ?? []).flatMap((widths, joint) =>
    predicted[joint].flatMap((tau, at) => (tau === null ? [] : [tau - widths[at], tau + widths[at]])),
  );
  const rows = [...external, ...predicted, edges].flat();
  const bound = (pick) => rows.reduce((best, tau) => pick(best, tau ?? 0), 0) / data.per_torque;
  const low = Math.min(bound(Math.min), -0.1);
  const high = Math.max(bound(Math.max), 0.1);
  const pad = 0.06 * (high - low);
  data.joints.forEach((name, joint) => {
    const band = halfWidth && bandTraces(predicted[joint], halfWidth[joint], `${colour(method)}33`);
    const traces = [
      ...(band ?? []),
      curve(data.against, torques(external[joint]), { color: INK, width: 1.6 }),
      curve(method, torques(predicted[joint]), { color: colour(method), width: 1.6 }),
    ];
    Plotly.react(
      `joint-${joint}`,
      traces,
      layout({
        title: { text: `${escaped(name)} [N·m]`, font: { ...font, size: 13 }, x: 0.5, y: 0.97 },
        margin: { l: 40, r: 8, t: 28, b: 36 },
        showlegend: false,
        font: { ...font, size: 11 },
        xaxis: axis(timeTitle(), { title: { text: timeTitle(), standoff: 2 }, nticks: 6 }),
        yaxis: axis("", { range: [low - pad, high + pad], nticks: 5 }),
      }),
      { ...config, displayModeBar: false },
    );
  });
  const entry = (title, line) => {
    const span = document.createElement("span");
    span.textContent = title;
    span.style.setProperty("--line", line);
    return span;
  };
  byId("joints-legend").replaceChildren(
    entry(data.against, INK),
    entry(`predicted by ${method}`, colour(method)),
    ...(halfWidth ? [entry(`its ${percent(level())} band`, `${colour(method)}55`)] : []),
  );
}

const level = () => data.level[chosen("method")];
const percent = (share) => `${Math.round(100 * share)} %`;

/** The share of torques inside the bands, over their level. */
function drawCoverage() {
  const method = data.methods[chosen("method")];
  const rows = data.by_level[chosen("method")];
  byId("coverage-section").hidden = !rows;
  document.querySelectorAll(".banded").forEach((span) => (span.hidden = !rows));
  if (!rows) return;
  const of = (at) => rows.map((row) => 100 * row[at]);
  const line = (name, y, more) => ({ x: of(0), y, name, hovertemplate: "%{y:.1f} %", ...more });
  const traces = [
    line("level", of(0), { mode: "lines", line: { color: GREY, dash: "dot" } }),
    line(`inside the bands of ${method}`, of(1), { mode: "lines+markers", line: { color: colour(method) } }),
  ];
  const range = [45, 100];
  const lowest = Math.min(45, ...of(1).map((share) => share - 5));
  Plotly.react(
    "coverage",
    traces,
    layout({
      xaxis: axis("level [%]", { range }),
      yaxis: axis("torques inside [%]", { range: [lowest, 100] }),
    }),
    flat,
  );
}

function drawContacts() {
  const method = data.methods[chosen("method")];
  const area = {
    fill: "tozeroy",
    fillcolor: "rgba(138, 144, 156, 0.18)",
    yaxis: "y2",
    hovertemplate: "%{y} points",
  };
  const error = errorOf(chosen("method"));
  const traces = [
    curve("contacts", touch().contacts, { color: GREY, width: 1.2 }, area),
    curve(`error of ${method}`, error, { color: colour(method), width: 2 }),
  ];
  Plotly.react(
    "contacts",
    traces,
    layout({
      margin: { l: 56, r: 56, t: 12, b: 48 },
      xaxis: axis(timeTitle()),
      // The error is drawn over the contacts, so its axis must overlay theirs.
      yaxis: axis("error [N·m]", { rangemode: "tozero", overlaying: "y2", showgrid: false }),
      yaxis2: axis("contacts [points]", { rangemode: "tozero", side: "right" }),
      shapes: marker(),
    }),
    flat,
  );
}

// Field and arm.

const poses = () => data.scene.poses[chosen("touch")]?.[chosen("frame")] ?? [];

/** All points that the axes must contain: the field, and the arm in some frames of every touch. */
function everywhere() {
  const arms = data.scene.poses.flatMap((frames) => {
    const step = Math.max(1, Math.floor(frames.length / 8));
    return frames.filter((_, frame) => frame % step === 0).map(armAt);
  });
  return [pointsFrom(0), ...arms];
}

/** The elastic body at the chosen frame: lines of wood, midpoints of leaves. */
function bodyNow() {
  const { joined_to, every, frames } = data.scene.body;
  const touch = frames[chosen("touch")] ?? [];
  const numbers = touch[Math.min(Math.floor(chosen("frame") / every), touch.length - 1)] ?? [];
  const wood = { x: [], y: [], z: [] };
  const ends = [];
  let at = 0;
  const take = () => [0, 1, 2].map(() => unpacked(numbers[at++]));
  const add = (to, place) => ["x", "y", "z"].forEach((side, axis) => to[side].push(place[axis]));
  if (numbers.length > 0) {
    for (const before of joined_to) {
      add(wood, before < 0 ? take() : ends[before]);
      ends.push(take());
      add(wood, ends.at(-1));
      add(wood, [null, null, null]);
    }
  }
  return { wood, leaves: places(numbers, at / 3) };
}

/** The body, and the cloud that it was made from, which shows where it is at rest. */
function bodyTraces() {
  if (!data.scene.body) return [];
  const { cloud, colours } = data.scene.body;
  const { wood, leaves } = bodyNow();
  const quiet = { type: "scatter3d", hoverinfo: "skip" };
  return [
    { ...quiet, ...wood, mode: "lines", name: "wood", connectgaps: false, line: { width: 6, color: "#8a4b14" } },
    { ...quiet, ...leaves, mode: "markers", name: "leaves", marker: { size: 4, color: "#3c9a2b", symbol: "diamond" } },
    { ...quiet, ...places(cloud), mode: "markers", name: "cloud", marker: { size: 1.4, color: colours, opacity: 0.55 } },
  ];
}

function drawScene() {
  const arm = mesh(armAt(poses()), 1);
  const cells = cellsTrace(pointsFrom(threshold()), Math.log10(stiffest()));
  const body = data.scene.body ? [places(data.scene.body.cloud)] : [];
  const axes = axesAround([...everywhere(), ...body], "scene");
  Plotly.react("scene", [arm, cells, ...bodyTraces()], space(axes), config);
}

function moveArm() {
  const { x, y, z } = armAt(poses());
  Plotly.restyle("scene", { x: [x], y: [y], z: [z] }, [0]);
  if (data.scene.body) {
    const { wood, leaves } = bodyNow();
    const both = (side) => [wood[side], leaves[side]];
    Plotly.restyle("scene", { x: both("x"), y: both("y"), z: both("z") }, [2, 3]);
  }
  Plotly.relayout("error", { shapes: marker() });
  Plotly.relayout("contacts", { shapes: marker() });
}

// Words and controls.

function updateCaptions() {
  const { every, frames, counted: noClock } = touch();
  const ordinal = { 2: "second", 3: "third" }[every] ?? `${every}th`;
  const thinned =
    every > 1 ? `Every ${ordinal} of the touch's ${counted(frames)} frames is drawn.` : "";
  document.querySelectorAll(".thinned").forEach((span) => (span.textContent = thinned));
  const against = { truth: "true", measured: "measured" }[data.against] ?? data.against;
  document.querySelectorAll(".against").forEach((span) => (span.textContent = against));
  if (!data.scene) return;
  const frame = chosen("frame") * every;
  const time = noClock ? "" : `${(here() ?? 0).toFixed(2)} s, `;
  byId("frame-shown").textContent = `${time}frame ${frame} of ${frames}`;
  showThreshold();
  showFieldCaption("scene-caption", data.scene.hulls.length > 0);
}

function chooseTouch() {
  if (data.scene) {
    // The arm is first shown in the frame with the largest torque.
    const size = norms(touch().external);
    byId("frame").max = Math.max(0, touch().time.length - 1);
    byId("frame").value = Math.max(0, size.indexOf(Math.max(...size)));
  }
  drawError();
  drawJoints();
  drawContacts();
  if (data.scene) moveArm();
  updateCaptions();
}

options(byId("touch"), data.touches.map(({ name }) => name), 0);
options(byId("method"), data.methods, data.subject);
data.joints.forEach((_, joint) => {
  const panel = document.createElement("div");
  panel.id = `joint-${joint}`;
  byId("joints").append(panel);
});
if (data.scene) {
  drawScene();
  byId("frame").addEventListener("input", updateCaptions);
  byId("frame").addEventListener("input", paced(moveArm));
  listenToThreshold("scene");
  listenToViews("scene");
} else {
  byId("scene-section").remove();
}
byId("touch").addEventListener("change", chooseTouch);
byId("method").addEventListener("change", () => {
  drawJoints();
  drawContacts();
  drawCoverage();
});
byId("controls").addEventListener("submit", (event) => event.preventDefault());
if (data.touches.length > 0) chooseTouch();
drawCoverage();
