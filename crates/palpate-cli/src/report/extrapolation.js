// Draws the field with the arm that touched it, and the cloud that it was extrapolated to.

const { scene, cloud } = data;

const seen = places(cloud.points);
const colours = cloud.stiffness.map((_, at) => `#${cloud.colours.slice(6 * at, 6 * at + 6)}`);
const touched = Array.from(cloud.touched, Number);

/** Decimal logarithm of the stiffness at the top of the colour bar, and the number of decades below it. */
const range = [Math.log10(data.range[1]), Math.log10(data.range[1] / data.range[0])];

// Left: the field and the arm.

/** The poses of the arm that are drawn: that of the chosen touch, or those of all touches. */
const poses = () => {
  const all = scene.poses.map((frames) => frames[0]);
  return chosen("arm") < all.length ? [all[chosen("arm")]] : all;
};

function arm(shown) {
  const arms = shown.map(armAt);
  const along = (side) => arms.flatMap((at) => at[side]);
  const opacity = shown.length > 1 ? 0.16 : 0.4;
  return mesh({ x: along("x"), y: along("y"), z: along("z") }, shown.length, { opacity, color: "#9aa5b5" });
}

/** The axes, the same for both plots, so that a point has the same position in both. */
const axes = (plot) => axesAround([pointsFrom(0), seen], plot);

function drawField() {
  const cells = cellsTrace(pointsFrom(threshold()), ...range);
  Plotly.react("field", [arm(poses()), cells], space(axes("field")), config);
}

function moveArm() {
  const { x, y, z, i, j, k, opacity } = arm(poses());
  Plotly.restyle("field", { x: [x], y: [y], z: [z], i: [i], j: [j], k: [k], opacity }, [0]);
}

// Right: the cloud.

const colourings = [
  {
    name: "stiffness",
    said: "coloured by extrapolated stiffness, on a logarithmic scale",
    marker: () => logarithmic(cloud.stiffness, "K [N/m]", "Viridis", ...range),
  },
  {
    name: "uncertainty",
    said: "coloured by the standard deviation of the stiffness, on a logarithmic scale",
    marker: () =>
      logarithmic(cloud.std, "standard deviation of K [N/m]", "Cividis", Math.log10(cloud.std_top)),
  },
  {
    name: "as seen",
    said: "in the colours that the camera saw",
    marker: () => ({ color: colours, showscale: false }),
  },
  {
    name: "touched or not",
    said: "coloured by whether the arm touched the cell there",
    marker: () => ({
      color: touched,
      cmin: 0,
      cmax: 1,
      // A step: its lower half is one colour, its upper half the other.
      colorscale: [[0, "#c3c9d3"], [0.5, "#c3c9d3"], [0.5, "#0072b2"], [1, "#0072b2"]],
      showscale: true,
      colorbar: bar("", { tickvals: [0.25, 0.75], ticktext: ["not touched", "touched"] }),
    }),
  },
];

function drawCloud() {
  const trace = {
    type: "scatter3d",
    mode: "markers",
    name: "cloud",
    ...seen,
    customdata: cloud.stiffness.map((k, at) => [k, cloud.std[at], touched[at] ? "touched" : "not touched"]),
    hovertemplate:
      "K = %{customdata[0]:.3~g} ± %{customdata[1]:.3~g} N/m, %{customdata[2]}<br>" +
      "x %{x:.3f} m, y %{y:.3f} m, z %{z:.3f} m<extra></extra>",
    marker: { size: 1.8, ...colourings[chosen("colouring")].marker() },
  };
  // The camera stays where the reader turned it.
  const camera = byId("cloud").layout?.scene?.camera;
  const view = { ...axes("cloud"), ...(camera ? { camera } : {}) };
  Plotly.react("cloud", [trace], space(view), config);
}

// Words and controls.

function updateCaptions() {
  showThreshold();
  showFieldCaption("field-caption", scene.poses.length > 0);
  const drawn = cloud.stiffness.length;
  const thinned = drawn < cloud.all ? `, of which ${counted(drawn)} are drawn, evenly chosen` : "";
  byId("cloud-caption").textContent =
    `${counted(cloud.all)} points that the camera sees${thinned}, ` +
    `${colourings[chosen("colouring")].said}.`;
}

/** Position of the slider for a stiffness, in percent. */
function percentOf(stiffness) {
  const decades = Math.log10(Math.max(stiffness, 1e-9) / stiffest());
  return Math.max(0, Math.min(100, Math.round(100 * (1 + decades / DECADES))));
}

/** The current camera of a plot; its layout only has the camera of the last time that the mouse was released. */
function cameraOf(plot) {
  return byId(plot)._fullLayout.scene._scene.getCamera();
}

/** Plots whose view was just copied from the other plot: it must not be copied back. */
const given = new Set();

/** Copies the view of plot `from` to plot `to` once it is at rest: it moves on after the mouse is released. */
function takeView(from, to, before) {
  const camera = cameraOf(from);
  const apart = (a, b) => Math.hypot(a.eye.x - b.eye.x, a.eye.y - b.eye.y, a.eye.z - b.eye.z);
  if (!before || apart(camera, before) > 1e-6) {
    setTimeout(() => takeView(from, to, structuredClone(camera)), 100);
  } else if (apart(camera, cameraOf(to)) > 1e-3) {
    given.add(to);
    // A copy: plotly.js turns the object that it is given.
    Plotly.relayout(to, { "scene.camera": structuredClone(camera) });
  }
}

/** Makes plot `to` turn with plot `from`. */
function turnTogether(from, to) {
  byId(from).on("plotly_relayout", (change) => {
    if (change["scene.camera"] && !given.delete(from)) {
      takeView(from, to);
    }
  });
}

const touches = scene.poses.map((_, at) => `touch ${at + 1}`);
const names = touches.length > 1 ? [...touches, "all touches"] : touches;
options(byId("arm"), names, 0);
byId("arm").disabled = names.length === 0;
options(byId("colouring"), colourings.map(({ name }) => name), 0);
byId("threshold").value = percentOf(data.threshold);
drawField();
drawCloud();
listenToThreshold("field");
byId("arm").addEventListener("change", moveArm);
byId("colouring").addEventListener("change", drawCloud);
byId("colouring").addEventListener("change", updateCaptions);
listenToViews("field", "cloud");
turnTogether("field", "cloud");
turnTogether("cloud", "field");
updateCaptions();
