(() => {
  "use strict";
  const source = JSON.parse(document.getElementById("data").textContent);
  const shared = { $t: source.t };
  const drawn = new Map();
  const narrow = () => window.innerWidth < 640;

  // "--name" becomes a colour of the style sheet, "$name" a shared array.
  const resolve = (value, style) => {
    if (typeof value === "string") {
      if (value.startsWith("--")) return style.getPropertyValue(value).trim() || "#888";
      return Object.hasOwn(shared, value) ? { ...shared[value] } : value;
    }
    if (Array.isArray(value)) return value.map((v) => resolve(v, style));
    if (value && typeof value === "object") {
      if (value.packed) return unpack(value);
      const out = {};
      for (const key of Object.keys(value)) out[key] = key === "bdata" ? value[key] : resolve(value[key], style);
      return out;
    }
    return value;
  };

  // Rows of 16-bit steps become rows of numbers; the lowest integer means no value.
  const unpack = ({ packed, step, columns }) => {
    const bytes = new DataView(Uint8Array.from(atob(packed), (c) => c.charCodeAt(0)).buffer);
    const rows = [];
    for (let k = 0; k < bytes.byteLength / 2; k += columns) {
      const row = new Array(columns);
      for (let i = 0; i < columns; i++) {
        const n = bytes.getInt16(2 * (k + i), true);
        row[i] = n === -32768 ? null : n * step;
      }
      rows.push(row);
    }
    return rows;
  };

  const merge = (a, b) => {
    const out = { ...a };
    for (const key of Object.keys(b)) {
      const both = a[key] && b[key] && typeof a[key] === "object" && typeof b[key] === "object";
      out[key] = both && !Array.isArray(a[key]) && !Array.isArray(b[key]) ? merge(a[key], b[key]) : b[key];
    }
    return out;
  };

  const base = (figure, style) => {
    const colour = (name) => style.getPropertyValue(name).trim();
    const axis = { gridcolor: colour("--grid"), linecolor: colour("--rule"), zerolinecolor: colour("--rule"), zeroline: false, ticks: "",
      tickfont: { size: 11 }, automargin: false };
    const layout = {
      height: figure.height, autosize: true, showlegend: false, dragmode: figure.timed && !narrow() ? "zoom" : false,
      margin: figure.timed ? { l: narrow() ? Math.min(source.left || 46, 84) : source.left || 62, r: 20, t: 26, b: 24 } : { l: 24, r: 24, t: 24, b: 24 },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: colour("--ink") },
      hoverlabel: { bgcolor: colour("--card"), bordercolor: colour("--rule"), font: { color: colour("--ink"), size: 12 } },
      legend: { orientation: "h", x: 1, xanchor: "right", y: 1, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" },
    };
    if (!figure.timed) {
      layout.polar = { bgcolor: "rgba(0,0,0,0)", angularaxis: { gridcolor: colour("--grid"), linecolor: colour("--rule") },
        radialaxis: { gridcolor: colour("--grid"), linecolor: "rgba(0,0,0,0)", tickfont: { size: 10, color: colour("--muted") } } };
      for (const key of Object.keys(figure.layout)) if (/^[xy]axis/.test(key)) layout[key] = { ...axis };
      return layout;
    }
    const ms = axisRange();
    layout.xaxis = { ...axis, type: "date", showgrid: true, range: ms, hoverformat: "%H:%M:%S", nticks: narrow() ? 5 : 10,
      tickformatstops: [{ dtickrange: [null, 1000], value: "%H:%M:%S.%L" }, { dtickrange: [1000, 60000], value: "%H:%M:%S" },
        { dtickrange: [60000, 86400000], value: "%H:%M" }, { dtickrange: [86400000, null], value: "%Y-%m-%d" }] };
    for (const key of Object.keys(figure.layout)) if (key.startsWith("yaxis")) layout[key] = { ...axis };
    if (!layout.yaxis) layout.yaxis = { ...axis };
    return layout;
  };

  let zoom = null;
  let full = null;
  const axisRange = () => {
    if (!full) {
      const bytes = Uint8Array.from(atob(source.t.bdata), (c) => c.charCodeAt(0));
      const t = new Float64Array(bytes.buffer);
      const pad = Math.max((t[t.length - 1] - t[0]) * 0.004, 500);
      full = [t[0] - pad, t[t.length - 1] + pad];
    }
    return (zoom || full).slice();
  };

  const draw = (figure, again) => {
    const box = document.getElementById("fig-" + figure.name);
    if (!box || (drawn.has(box) && !again)) return;
    const style = getComputedStyle(document.documentElement);
    const layout = merge(base(figure, style), resolve(figure.layout, style));
    const data = resolve(figure.data, style);
    if (narrow()) for (const trace of data) if (trace.colorbar) trace.colorbar = { ...trace.colorbar, len: 0.7 };
    if (drawn.has(box)) data.forEach((trace, i) => { trace.visible = box.data[i] ? box.data[i].visible : trace.visible; });
    const first = !drawn.has(box);
    drawn.set(box, figure);
    Plotly.react(box, data, layout, { displayModeBar: false, responsive: true, scrollZoom: false, doubleClick: figure.timed ? false : "reset" });
    if (!first) return;
    if (figure.views.length > 1) addViews(box, figure);
    if (figure.timed) {
      box.on("plotly_relayout", (event) => linked(box, event));
      box.on("plotly_doubleclick", () => show(null));
    }
  };

  // All time axes move together.
  const linked = (box, event) => {
    const from = event["xaxis.range[0]"], to = event["xaxis.range[1]"];
    if (from === undefined || box.dataset.following) return;
    show([from, to], box);
  };
  const show = (range, except) => {
    zoom = range;
    for (const [box, figure] of drawn) {
      if (!figure.timed || box === except) continue;
      box.dataset.following = "1";
      Plotly.relayout(box, { "xaxis.range": axisRange() }).then(() => { delete box.dataset.following; });
    }
  };

  const addViews = (box, figure) => {
    const bar = document.createElement("div");
    bar.className = "views";
    figure.views.forEach((view, i) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = view.label;
      button.setAttribute("aria-pressed", String(i === 0));
      button.addEventListener("click", () => {
        bar.querySelectorAll("button").forEach((b) => b.setAttribute("aria-pressed", String(b === button)));
        Plotly.restyle(box, { visible: figure.data.map((_, k) => view.show.includes(k)) });
      });
      bar.append(button);
    });
    box.before(bar);
  };

  // Room is kept at once, drawing waits until a figure comes near the window.
  const byName = new Map(source.figures.map((f) => ["fig-" + f.name, f]));
  for (const [id, figure] of byName) {
    const box = document.getElementById(id);
    if (box) box.style.minHeight = figure.height + "px";
  }
  const watcher = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) { watcher.unobserve(entry.target); draw(byName.get(entry.target.id)); }
  }, { rootMargin: "600px" });
  for (const id of byName.keys()) { const box = document.getElementById(id); if (box) watcher.observe(box); }
  const all = (again) => source.figures.forEach((f) => { if (!again || drawn.has(document.getElementById("fig-" + f.name))) draw(f, again); });
  window.addEventListener("beforeprint", () => all(false));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => all(true));
})();
