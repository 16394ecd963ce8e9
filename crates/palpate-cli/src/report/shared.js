// Shared by the pages: the JSON beside the script, how plots look, and the field and the arm in 3-D.
// data.rs and packed.rs describe the numbers.
"use strict";

const byId = (id) => document.getElementById(id);
const data = JSON.parse(byId("data").textContent);
/** The value of a control of the page, a number. */
const chosen = (id) => Number(byId(id).value);

const INK = "#22262e";
const FAINT = "#e4e7ec";
const GREY = "#8a909c";
/** Powers of ten that the colours span. */
const DECADES = 2.5;

const config = {
  responsive: true,
  displaylogo: false,
  modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d", "resetCameraLastSave3d"],
};
const font = { family: getComputedStyle(document.body).fontFamily, size: 13, color: INK };
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
/** The layout of a 3-D plot. */
const space = (scene) =>
  layout({ margin: { l: 0, r: 0, t: 0, b: 0 }, hovermode: "closest", showlegend: false, scene });

/** Converts an integer of the JSON back to a number. */
const unpacked = (whole) => whole / data.per_one;
/** The view of the picture for papers, at the smallest distance that shows the whole box. */
const nearer = ([x, y, z]) => ({ x: 1.8 * x, y: 1.8 * y, z: 1.8 * z });
const eyes = {
  oblique: { x: 0.97, y: -1.31, z: 0.56 },
  front: { x: 1.6, y: 0.001, z: 0 },
  side: { x: 0.001, y: -1.6, z: 0 },
  top: { x: 0, y: -0.001, z: 1.6 },
  ...(data.eye ? { oblique: nearer(data.eye) } : {}),
};

/** A camera that sees the whole box; in a narrow plot it is farther away. */
function camera(view, plot) {
  const { clientWidth, clientHeight } = byId(plot);
  // Plots side by side are higher than wide, and their boxes narrow.
  const fill = data.eye ? 0.95 : 1.12;
  const farther = Math.max(1, (fill * clientHeight) / Math.max(clientWidth, 1));
  const { x, y, z } = eyes[view];
  // Looking a little below the middle leaves room for the labels of the lower axes.
  return { eye: { x: farther * x, y: farther * y, z: farther * z }, center: { x: 0, y: 0, z: -0.08 } };
}

/** Vertices of all hulls in the world frame, m, for their poses. */
function armAt(poses) {
  const [x, y, z] = [[], [], []];
  data.scene.hulls.forEach(({ vertices }, hull) => {
    const [px, py, pz, ...turn] = poses.slice(7 * hull, 7 * hull + 7);
    const [i, j, k, w] = turn.map(unpacked);
    for (let at = 0; at + 2 < vertices.length; at += 3) {
      const [a, b, c] = [vertices[at], vertices[at + 1], vertices[at + 2]];
      // v + 2 w (u × v) + 2 u × (u × v), with u = (i, j, k).
      const [s, t, r] = [2 * (j * c - k * b), 2 * (k * a - i * c), 2 * (i * b - j * a)];
      x.push(unpacked(px + a + w * s + (j * r - k * t)));
      y.push(unpacked(py + b + w * t + (k * s - i * r)));
      z.push(unpacked(pz + c + w * r + (i * t - j * s)));
    }
  });
  return { x, y, z };
}

/** Vertex numbers of the triangles of all hulls, for this number of arms one after the other. */
function triangles(arms) {
  const corners = { i: [], j: [], k: [] };
  let first = 0;
  for (let arm = 0; arm < arms; arm += 1) {
    for (const hull of data.scene.hulls) {
      for (const [a, b, c] of hull.triangles) {
        corners.i.push(first + a);
        corners.j.push(first + b);
        corners.k.push(first + c);
      }
      first += hull.vertices.length / 3;
    }
  }
  return corners;
}

const mesh = (vertices, arms, more) => ({
  type: "mesh3d",
  name: "arm",
  ...vertices,
  ...triangles(arms),
  color: "#d3d7dd",
  flatshading: false,
  lighting: { ambient: 0.62, diffuse: 0.6, specular: 0.08, roughness: 0.9 },
  lightposition: { x: -2000, y: -3000, z: 4000 },
  hoverinfo: "skip",
  ...more,
});

/** Points from a list of integers, three for each point, from point number `first` on. */
const places = (points, first = 0) => {
  const along = (side) =>
    Array.from({ length: points.length / 3 - first }, (_, at) => unpacked(points[3 * (at + first) + side]));
  return { x: along(0), y: along(1), z: along(2) };
};

const stiffest = () => Math.max(data.scene.stiffness.at(-1) ?? 1, 1e-6);
/** The stiffness that the slider selects, N/m; 0 at its left end, where all points are shown. */
function threshold() {
  const percent = chosen("threshold");
  return percent === 0 ? 0 : stiffest() * 10 ** (DECADES * (percent / 100 - 1));
}

/** Number of points of the field that are at least as stiff as a threshold. */
const countFrom = (threshold) => data.scene.stiffness.filter((k) => k >= threshold).length;

/** The points that are at least as stiff as a threshold: the last ones, since the softest come first. */
function pointsFrom(threshold) {
  const first = data.scene.stiffness.length - countFrom(threshold);
  return { ...places(data.scene.points, first), stiffness: data.scene.stiffness.slice(first) };
}

/** Shows the selected threshold beside the slider. */
function showThreshold() {
  const shown = countFrom(threshold());
  const least = threshold() === 0 ? "none" : `${Number(threshold().toPrecision(3))} N/m`;
  byId("threshold-shown").textContent = `${least} (${counted(shown)} shown)`;
}

/** Writes the caption of a plot of the field and the arm. */
function showFieldCaption(caption, arm) {
  const { cells, stiffness, spacing } = data.scene;
  const part = stiffness.length < cells ? `the stiffest ${counted(stiffness.length)} of ` : "";
  const hulls = arm ? " Each link of the arm is drawn as its convex hull." : "";
  const body = data.scene.body
    ? " The elastic body, wood or blocks as brown lines and leaves as green diamonds, bends under the arm; small" +
      " points are the cloud that it was made from, at rest."
    : "";
  byId(caption).textContent =
    `Stiffness of ${part}${counted(cells)} touched points, ${(spacing * 100).toFixed(2)} cm ` +
    `apart, on a logarithmic scale.${hulls}${body} Drag to turn, scroll to zoom.`;
}

const logs = (numbers) => numbers.map((number) => Math.log10(Math.max(number, 1e-9)));

/** Axes that contain all points, with the same scale along all three. */
function axesAround(clouds, plot) {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  const empty = clouds.every(({ x }) => x.length === 0);
  for (const { x, y, z } of empty ? [{ x: [0], y: [0], z: [0] }] : clouds) {
    [x, y, z].forEach((values, side) => {
      for (const value of values) {
        low[side] = Math.min(low[side], value);
        high[side] = Math.max(high[side], value);
      }
    });
  }
  const lengths = low.map((from, side) => Math.max(high[side] - from, 0.05) * 1.04);
  const longest = Math.max(...lengths);
  const side = (name, at) => {
    const middle = (low[at] + high[at]) / 2;
    const range = [middle - lengths[at] / 2, middle + lengths[at] / 2];
    return {
      title: { text: `${name} [m]` },
      range,
      gridcolor: FAINT,
      backgroundcolor: "#fff",
      showspikes: false,
      nticks: 6,
    };
  };
  const ratio = lengths.map((length) => length / longest);
  return {
    xaxis: side("x", 0),
    yaxis: side("y", 1),
    zaxis: side("z", 2),
    // Above the colour bar.
    domain: { x: [0, 1], y: [0.14, 1] },
    aspectmode: "manual",
    aspectratio: { x: ratio[0], y: ratio[1], z: ratio[2] },
    camera: camera("oblique", plot),
  };
}

/** Round tick values for a colour bar from 10^(top − decades) to 10^top. */
function ticks(top, decades) {
  const values = [];
  for (let decade = Math.floor(top - decades); decade <= top; decade += 1) {
    for (const digit of decades < 1.3 ? [1, 2, 3, 5, 7] : [1, 3]) values.push(digit * 10 ** decade);
  }
  const inside = values.filter((k) => Math.log10(k) >= top - decades && Math.log10(k) <= top);
  return { tickvals: logs(inside), ticktext: inside.map((k) => String(Number(k.toPrecision(1)))) };
}

/** A colour bar below a plot. */
const bar = (title, more) => ({
  title: { text: title, side: "top" },
  orientation: "h",
  thickness: 12,
  len: 0.9,
  y: 0.13,
  yanchor: "top",
  ...more,
});

/** Logarithmic colours for numbers from 10^(top − decades) to 10^top. */
const logarithmic = (numbers, title, colorscale, top, decades = DECADES) => ({
  color: logs(numbers),
  cmin: top - decades,
  cmax: top,
  colorscale,
  showscale: true,
  colorbar: bar(title, ticks(top, decades)),
});

/** The plot of the field's points, with colours from 10^(top − decades) to 10^top. */
const cellsTrace = (points, top, decades) => ({
  type: "scatter3d",
  mode: "markers",
  name: "field",
  x: points.x,
  y: points.y,
  z: points.z,
  customdata: points.stiffness,
  hovertemplate:
    "K = %{customdata:.3~g} N/m<br>x %{x:.3f} m, y %{y:.3f} m, z %{z:.3f} m<extra></extra>",
  marker: { size: 3.2, ...logarithmic(points.stiffness, "K [N/m]", "Viridis", top, decades) },
});

/** Makes the slider hide soft points of the field, which are the second trace of the plot. */
function listenToThreshold(plot) {
  const filter = paced(() => {
    const { x, y, z, stiffness } = pointsFrom(threshold());
    const update = { x: [x], y: [y], z: [z], customdata: [stiffness] };
    Plotly.restyle(plot, { ...update, "marker.color": [logs(stiffness)] }, [1]);
  });
  byId("threshold").addEventListener("input", showThreshold);
  byId("threshold").addEventListener("input", filter);
}

const escaped = (text) =>
  text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
const counted = (number) => number.toLocaleString("en");

function options(select, names, picked) {
  select.replaceChildren(...names.map((name, at) => new Option(name, at, false, at === picked)));
}

/** Limits redrawing to once per screen frame, however fast a slider moves. */
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

/** Makes the buttons of the page set the view of plots. */
function listenToViews(...plots) {
  document.querySelectorAll("[data-view]").forEach((button) =>
    button.addEventListener("click", () => {
      for (const plot of plots) {
        Plotly.relayout(plot, { "scene.camera": camera(button.dataset.view, plot) });
      }
    }),
  );
}
