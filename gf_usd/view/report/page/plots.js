// Curves over playback time, with a line at the frame that is shown.

const INKS = {
  light: ["#2f6fb5", "#c8553d", "#3b8f6b", "#8a63b0", "#b88a1f"],
  dark: ["#6aa9ea", "#ee8a6f", "#63c296", "#b794dd", "#e0b755"],
};

class Plots {
  constructor(holder, seek) {
    Object.assign(this, { holder, seek, drawn: [] });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      if (this.of) this.variant(this.of);
    });
  }

  variant(variant) {
    this.of = variant;
    this.drawn.forEach((plot) => Plotly.purge(plot));
    this.holder.replaceChildren();
    this.drawn = variant.plots.map((plot) => this.make(plot, variant));
  }

  make(plot, variant) {
    const card = document.createElement("figure");
    card.className = "plot";
    const caption = document.createElement("figcaption");
    const title = document.createElement("b");
    title.textContent = plot.unit ? `${plot.title} [${plot.unit}]` : plot.title;
    const meaning = document.createElement("span");
    meaning.textContent = plot.meaning;
    caption.append(title, meaning);
    const canvas = document.createElement("div");
    const keys = document.createElement("div");
    keys.className = "keys";
    card.append(caption, keys, canvas);
    this.holder.append(card);
    const style = getComputedStyle(document.documentElement);
    const [text, line] = ["--soft", "--line"].map((name) => style.getPropertyValue(name).trim());
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    const inks = INKS[dark ? "dark" : "light"];
    const traces = plot.curves.map((curve, i) => ({
      x: curve.x, y: curve.y, name: curve.name, type: "scatter", mode: "lines",
      line: { width: 1.8, color: inks[i % inks.length] },
      hovertemplate: `%{y:.4~g} ${plot.unit}`,
    }));
    plot.curves.forEach((curve, i) => {
      if (curve.band) traces.push(...bandOf(curve, inks[i % inks.length]));
    });
    const end = variant.seconds.at(-1);
    const shapes = [cursorAt(variant.seconds[0], dark)];
    if (plot.line !== undefined) {
      shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, y0: plot.line, y1: plot.line,
        line: { width: 1, color: text, dash: "dot" } });
    }
    const axis = { gridcolor: line, zeroline: false, linecolor: line, tickfont: { size: 10 } };
    Plotly.newPlot(canvas, traces, {
      height: window.innerWidth > 1800 ? 216 : 132, margin: { l: 42, r: 6, t: 6, b: 22 }, shapes, hovermode: "x unified",
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: "system-ui, sans-serif", size: 11, color: text },
      hoverlabel: { font: { size: 11 }, bgcolor: style.getPropertyValue("--card").trim() },
      showlegend: false,
      xaxis: { ...axis, range: [0, end], ticksuffix: " s", nticks: 6 },
      yaxis: { ...axis, nticks: 5, exponentformat: "power" },
    }, { displayModeBar: false, responsive: true });
    const named = traces.filter((trace) => !trace.fill && trace.name);
    if (named.length > 1) keys.append(...named.map((trace, i) => keyOf(trace, i, canvas)));
    canvas.on("plotly_click", (e) => this.seek(e.points[0].x));
    return canvas;
  }

  frame(frame, variant) {
    const x = variant.seconds[frame];
    for (const plot of this.drawn) Plotly.relayout(plot, { "shapes[0].x0": x, "shapes[0].x1": x });
  }
}

// Two traces around a curve and the area between them, as far as it is known.
function bandOf(curve, ink) {
  const known = curve.band.findLastIndex((half) => half !== null) + 1;
  const x = curve.x.slice(0, known);
  const edge = (sign) => x.map((_, i) => curve.y[i] + sign * curve.band[i]);
  const one = { x, type: "scatter", mode: "lines", line: { width: 0 }, hoverinfo: "skip" };
  return [{ ...one, y: edge(-1) }, { ...one, y: edge(1), fill: "tonexty", fillcolor: `${ink}40` }];
}

// The name of a curve, which hides and shows it.
function keyOf(trace, number, canvas) {
  const key = document.createElement("button");
  key.type = "button";
  const ink = document.createElement("i");
  ink.style.background = trace.line.color;
  key.append(ink, trace.name);
  key.setAttribute("aria-pressed", "true");
  key.addEventListener("click", () => {
    const shown = key.getAttribute("aria-pressed") !== "true";
    key.setAttribute("aria-pressed", shown);
    Plotly.restyle(canvas, { visible: shown }, [number]);
  });
  return key;
}

function cursorAt(x, dark) {
  return { type: "line", yref: "paper", y0: 0, y1: 1, x0: x, x1: x,
    line: { width: 1.5, color: dark ? "#f2f2f2" : "#20242c" } };
}
