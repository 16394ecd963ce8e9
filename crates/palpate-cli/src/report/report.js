// Draws the figures of the report from the JSON beside it. What the numbers mean is said in
// data.rs; nothing is computed here but errors, which are norms, and where the arm's vertices are.
"use strict";

(() => {
  const byId = (id) => document.getElementById(id);
  const data = JSON.parse(byId("data").textContent);

  const INK = "#22262e";
  const FAINT = "#e4e7ec";
  const GREY = "#8a909c";
  // Okabe and Ito's colours, which the colour-blind can tell apart.
  const COLOURS = {
    map: "#0072b2",
    ekf: "#56b4e9",
    mlp: "#d55e00",
    gp: "#009e73",
    knn: "#cc79a7",
    uniform: "#e69f00",
    zero: GREY,
  };
  const DASHES = { ekf: "dash", uniform: "dot", knn: "dashdot" };
  /** Powers of ten that the colours span. */
  const DECADES = 2.5;

  const chosen = { touch: 0, method: data.subject, frame: 0, threshold: 0 };
  const touch = () => data.touches[chosen.touch];
  const colour = (method) => COLOURS[method] ?? INK;

  const config = {
    responsive: true,
    displaylogo: false,
    modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d", "resetCameraLastSave3d"],
  };
  // In a narrow window the buttons of a plot would lie on its legend.
  const flat = { ...config, displayModeBar: window.innerWidth < 700 ? false : "hover" };
  const font = { family: getComputedStyle(document.body).fontFamily, size: 13, color: INK };
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
  const layout = (more) => ({
    font,
    autosize: true,
    margin: { l: 56, r: 16, t: 12, b: 48 },
    paper_bgcolor: "#fff",
    plot_bgcolor: "#fff",
    hovermode: "x unified",
    legend: { orientation: "h", x: 0, xanchor: "left", y: 1.02, yanchor: "bottom" },
    ...more,
  });

  // Curves.

  /** Torques of one joint, N·m; a gap where they are not finite. */
  const torques = (row) => row.map((tau) => (tau === null ? null : tau / data.per_torque));

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
  const here = () => touch().time[chosen.frame];

  /** A thin line at the frame in which the 3-D view shows the arm. */
  const marker = () =>
    data.scene && touch().time.length > 0
      ? [
          {
            type: "line",
            x0: here(),
            x1: here(),
            y0: 0,
            y1: 1,
            yref: "paper",
            line: { color: GREY, width: 1, dash: "dot" },
          },
        ]
      : [];

  function drawError() {
    const { time, external } = touch();
    const torque = {
      x: time,
      y: norms(external),
      name: "zero (‖τ‖₂)",
      line: { color: "#a9aeb8", width: 1 },
      hovertemplate: "%{y:.3f} N·m",
    };
    const curves = data.methods
      .map((method, at) => ({
        x: time,
        y: method === "zero" ? null : errorOf(at),
        name: method,
        line: {
          color: colour(method),
          dash: DASHES[method] ?? "solid",
          width: at === data.subject ? 2.4 : 1.5,
        },
        hovertemplate: "%{y:.3f} N·m",
      }))
      .filter((curve) => curve.y !== null);
    Plotly.react(
      "error",
      [torque, ...curves],
      layout({
        xaxis: axis(timeTitle()),
        yaxis: axis("error [N·m]", { rangemode: "tozero" }),
        shapes: marker(),
      }),
      flat,
    );
  }

  function drawJoints() {
    const { time, external, predicted } = touch();
    const method = data.methods[chosen.method];
    const rows = [...external, ...(predicted[chosen.method] ?? [])].flat();
    const bound = (pick) => rows.reduce((best, tau) => pick(best, tau ?? 0), 0) / data.per_torque;
    const low = Math.min(bound(Math.min), -0.1);
    const high = Math.max(bound(Math.max), 0.1);
    const pad = 0.06 * (high - low);
    data.joints.forEach((name, joint) => {
      const curve = (row, title, style) => ({
        x: time,
        y: row === undefined ? [] : torques(row),
        name: title,
        line: style,
        hovertemplate: "%{y:.3f} N·m",
      });
      const traces = [
        curve(external[joint], data.against, { color: INK, width: 1.6 }),
        curve(predicted[chosen.method]?.[joint], method, { color: colour(method), width: 1.6 }),
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
    );
  }

  function drawContacts() {
    const { time, contacts } = touch();
    const method = data.methods[chosen.method];
    const traces = [
      {
        x: time,
        y: contacts,
        name: "contacts",
        fill: "tozeroy",
        fillcolor: "rgba(138, 144, 156, 0.18)",
        line: { color: GREY, width: 1.2 },
        yaxis: "y2",
        hovertemplate: "%{y} points",
      },
      {
        x: time,
        y: errorOf(chosen.method),
        name: `error of ${method}`,
        line: { color: colour(method), width: 2 },
        hovertemplate: "%{y:.3f} N·m",
      },
    ];
    Plotly.react(
      "contacts",
      traces,
      layout({
        margin: { l: 56, r: 56, t: 12, b: 48 },
        xaxis: axis(timeTitle()),
        // The error lies over the contacts, hence its axis over theirs.
        yaxis: axis("error [N·m]", { rangemode: "tozero", overlaying: "y2", showgrid: false }),
        yaxis2: axis("contacts [points]", { rangemode: "tozero", side: "right" }),
        shapes: marker(),
      }),
      flat,
    );
  }

  // Field and arm.

  const metres = (whole) => whole / data.per_metre;
  const eyes = {
    oblique: { x: 0.97, y: -1.31, z: 0.56 },
    front: { x: 1.6, y: 0.001, z: 0 },
    side: { x: 0.001, y: -1.6, z: 0 },
    top: { x: 0, y: -0.001, z: 1.6 },
  };

  /** A camera from which the whole box is seen, in a narrow window from farther away. */
  function camera(view) {
    const { clientWidth, clientHeight } = byId("scene");
    const farther = Math.max(1, (1.12 * clientHeight) / Math.max(clientWidth, 1));
    const { x, y, z } = eyes[view];
    // Looking a little below the middle leaves room for what stands beside the lower axes.
    return { eye: { x: farther * x, y: farther * y, z: farther * z }, center: { x: 0, y: 0, z: -0.08 } };
  }

  /** Vertices of all hulls in a frame: what moves when the arm does. */
  function armAt(touchAt, frame) {
    const poses = data.scene.poses[touchAt][frame] ?? [];
    const [x, y, z] = [[], [], []];
    data.scene.hulls.forEach(({ vertices }, hull) => {
      const [px, py, pz, ...turn] = poses.slice(7 * hull, 7 * hull + 7);
      const [i, j, k, w] = turn.map((part) => part / data.per_one);
      for (let at = 0; at + 2 < vertices.length; at += 3) {
        const [a, b, c] = [vertices[at], vertices[at + 1], vertices[at + 2]];
        // v + 2 w (u × v) + 2 u × (u × v), with u = (i, j, k).
        const [s, t, r] = [2 * (j * c - k * b), 2 * (k * a - i * c), 2 * (i * b - j * a)];
        x.push(metres(px + a + w * s + (j * r - k * t)));
        y.push(metres(py + b + w * t + (k * s - i * r)));
        z.push(metres(pz + c + w * r + (i * t - j * s)));
      }
    });
    return { x, y, z };
  }

  /** The points that are not softer than a threshold; they come softest first. */
  function pointsFrom(threshold) {
    const { points, stiffness } = data.scene;
    const first = stiffness.findIndex((k) => k >= threshold);
    const shown = first < 0 ? [] : stiffness.slice(first);
    const along = (side) =>
      shown.map((_, at) => metres(points[3 * (at + stiffness.length - shown.length) + side]));
    return { x: along(0), y: along(1), z: along(2), stiffness: shown };
  }

  const stiffest = () => Math.max(data.scene.stiffness.at(-1) ?? 1, 1e-6);
  const threshold = () =>
    chosen.threshold === 0 ? 0 : stiffest() * 10 ** (DECADES * (chosen.threshold / 100 - 1));
  const logs = (stiffness) => stiffness.map((k) => Math.log10(Math.max(k, 1e-9)));

  /** Axes that hold the field and the arm wherever a touch takes it, one scale along all three. */
  function sceneAxes() {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    const include = ({ x, y, z }) =>
      [x, y, z].forEach((values, side) => {
        for (const value of values) {
          low[side] = Math.min(low[side], value);
          high[side] = Math.max(high[side], value);
        }
      });
    include(pointsFrom(0));
    data.scene.poses.forEach((frames, at) => {
      const step = Math.max(1, Math.floor(frames.length / 8));
      for (let frame = 0; frame < frames.length; frame += step) include(armAt(at, frame));
    });
    const lengths = low.map((from, side) => Math.max(high[side] - from, 0.05) * 1.04);
    const longest = Math.max(...lengths.filter(Number.isFinite), 0.05);
    const side = (name, at) => {
      const middle = (low[at] + high[at]) / 2;
      const range = [middle - lengths[at] / 2, middle + lengths[at] / 2];
      return {
        title: { text: `${name} [m]` },
        ...(Number.isFinite(middle) ? { range } : {}),
        gridcolor: FAINT,
        backgroundcolor: "#fff",
        showspikes: false,
        nticks: 6,
      };
    };
    const ratio = lengths.map((length) => (Number.isFinite(length) ? length / longest : 1));
    return {
      xaxis: side("x", 0),
      yaxis: side("y", 1),
      zaxis: side("z", 2),
      domain: { x: [0, 1], y: [0.14, 1] }, // the colour bar stands below
      aspectmode: "manual",
      aspectratio: { x: ratio[0], y: ratio[1], z: ratio[2] },
      camera: camera("oblique"),
    };
  }

  /** Round stiffnesses for the colour bar. */
  function ticks(top) {
    const values = [];
    for (let decade = Math.floor(top - DECADES); decade <= top; decade += 1) {
      for (const digit of [1, 3]) values.push(digit * 10 ** decade);
    }
    const inside = values.filter((k) => Math.log10(k) >= top - DECADES && Math.log10(k) <= top);
    return { tickvals: logs(inside), ticktext: inside.map((k) => String(Number(k.toPrecision(1)))) };
  }

  function drawScene() {
    const top = Math.log10(stiffest());
    const points = pointsFrom(threshold());
    const arm = {
      type: "mesh3d",
      name: "arm",
      ...armAt(chosen.touch, chosen.frame),
      ...triangles(),
      color: "#d3d7dd",
      flatshading: false,
      lighting: { ambient: 0.62, diffuse: 0.6, specular: 0.08, roughness: 0.9 },
      lightposition: { x: -2000, y: -3000, z: 4000 },
      hoverinfo: "skip",
    };
    const cells = {
      type: "scatter3d",
      mode: "markers",
      name: "field",
      x: points.x,
      y: points.y,
      z: points.z,
      customdata: points.stiffness,
      hovertemplate:
        "K = %{customdata:.3~g} N/m<br>x %{x:.3f} m, y %{y:.3f} m, z %{z:.3f} m<extra></extra>",
      marker: {
        size: 3.2,
        color: logs(points.stiffness),
        cmin: top - DECADES,
        cmax: top,
        colorscale: "Viridis",
        colorbar: {
          title: { text: "K [N/m]", side: "top" },
          orientation: "h",
          thickness: 12,
          len: 0.9,
          y: 0.13,
          yanchor: "top",
          ...ticks(top),
        },
      },
    };
    const view = layout({
      margin: { l: 0, r: 0, t: 0, b: 0 },
      hovermode: "closest",
      showlegend: false,
      scene: sceneAxes(),
    });
    Plotly.react("scene", [arm, cells], view, config);
  }

  /** Corners of all hulls' triangles, counted through. */
  function triangles() {
    const corners = { i: [], j: [], k: [] };
    let first = 0;
    for (const hull of data.scene.hulls) {
      for (const [a, b, c] of hull.triangles) {
        corners.i.push(first + a);
        corners.j.push(first + b);
        corners.k.push(first + c);
      }
      first += hull.vertices.length / 3;
    }
    return corners;
  }

  function moveArm() {
    const { x, y, z } = armAt(chosen.touch, chosen.frame);
    Plotly.restyle("scene", { x: [x], y: [y], z: [z] }, [0]);
    Plotly.relayout("error", { shapes: marker() });
    Plotly.relayout("contacts", { shapes: marker() });
  }

  function filterPoints() {
    const { x, y, z, stiffness } = pointsFrom(threshold());
    const update = { x: [x], y: [y], z: [z], customdata: [stiffness] };
    Plotly.restyle("scene", { ...update, "marker.color": [logs(stiffness)] }, [1]);
  }

  // Words and controls.

  const escaped = (text) =>
    text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
  const counted = (number) => number.toLocaleString("en");

  function tell() {
    const { every, frames, counted: noClock } = touch();
    const ordinal = { 2: "second", 3: "third" }[every] ?? `${every}th`;
    const thinned =
      every > 1 ? `Every ${ordinal} of the touch's ${counted(frames)} frames is drawn.` : "";
    document.querySelectorAll(".thinned").forEach((span) => (span.textContent = thinned));
    const against = { truth: "true", measured: "measured" }[data.against] ?? data.against;
    document.querySelectorAll(".against").forEach((span) => (span.textContent = against));
    if (!data.scene) return;
    const frame = chosen.frame * every;
    const time = noClock ? "" : `${(here() ?? 0).toFixed(2)} s, `;
    byId("frame-shown").textContent = `${time}frame ${frame} of ${frames}`;
    const shown = data.scene.stiffness.filter((k) => k >= threshold()).length;
    const least = threshold() === 0 ? "none" : `${Number(threshold().toPrecision(3))} N/m`;
    byId("threshold-shown").textContent = `${least} (${counted(shown)} shown)`;
    const { cells, stiffness, spacing } = data.scene;
    const part = stiffness.length < cells ? `the stiffest ${counted(stiffness.length)} of ` : "";
    const arm = data.scene.hulls.length > 0 ? " Each link of the arm is drawn as its convex hull." : "";
    byId("scene-caption").textContent =
      `Stiffness of ${part}${counted(cells)} touched points, ${(spacing * 100).toFixed(2)} cm ` +
      `apart, on a logarithmic scale.${arm} Drag to turn, scroll to zoom.`;
  }

  function options(select, names, picked) {
    select.replaceChildren(...names.map((name, at) => new Option(name, at, false, at === picked)));
  }

  /** At most one redrawing a screen frame, however fast a slider moves. */
  function paced(draw) {
    let waiting = false;
    return () => {
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(() => {
        waiting = false;
        draw();
      });
    };
  }

  function chooseTouch() {
    chosen.touch = Number(byId("touch").value);
    // The arm is shown where it pushes hardest.
    const size = norms(touch().external);
    chosen.frame = Math.max(0, size.indexOf(Math.max(...size)));
    drawError();
    drawJoints();
    drawContacts();
    if (data.scene) {
      byId("frame").max = Math.max(0, touch().time.length - 1);
      byId("frame").value = chosen.frame;
      moveArm();
    }
    tell();
  }

  function listen() {
    byId("touch").addEventListener("change", chooseTouch);
    byId("method").addEventListener("change", () => {
      chosen.method = Number(byId("method").value);
      drawJoints();
      drawContacts();
    });
    byId("controls").addEventListener("submit", (event) => event.preventDefault());
  }

  function listenToScene() {
    const [move, filter] = [paced(moveArm), paced(filterPoints)];
    byId("frame").addEventListener("input", () => {
      chosen.frame = Number(byId("frame").value);
      tell();
      move();
    });
    byId("threshold").addEventListener("input", () => {
      chosen.threshold = Number(byId("threshold").value);
      tell();
      filter();
    });
    document.querySelectorAll("[data-view]").forEach((button) =>
      button.addEventListener("click", () => {
        Plotly.relayout("scene", { "scene.camera": camera(button.dataset.view) });
      }),
    );
  }

  function start() {
    options(byId("touch"), data.touches.map(({ name }) => name), 0);
    options(byId("method"), data.methods, chosen.method);
    data.joints.forEach((_, joint) => {
      const panel = document.createElement("div");
      panel.id = `joint-${joint}`;
      byId("joints").append(panel);
    });
    if (data.scene) {
      chosen.threshold = 40;
      byId("threshold").value = chosen.threshold;
      drawScene();
      listenToScene();
    } else {
      byId("scene-section").remove();
    }
    listen();
    if (data.touches.length > 0) chooseTouch();
  }

  start();
})();
