// The bench: reflectance of a tissue whose values are moved, from one recorded walk. No server, no network.
(() => {
  "use strict";
  const NS = "http://www.w3.org/2000/svg";

  /** Absorption of the last layer in 1/mm at each wavelength (Nunes 2019, eq. 6.12 to 6.15). */
  function absorption(data, p) {
    return data.wavelength_nm.map((_, w) => {
      let total = 0;
      for (const part of data.parts) {
        if (part.kind === "blood") {
          const s = p[part.path + ".oxygenation"];
          const sigma = part.deoxy[w] + s * (part.oxy[w] - part.deoxy[w]);
          const depth = 2e-3 * p[part.path + ".vessel_radius_um"] * sigma;
          const packed = depth > 0 ? -Math.expm1(-depth) / depth : 1;
          total += p[part.path + ".fraction"] * sigma * packed;
        } else if (part.kind === "pigment") {
          total += p[`${part.path}.${part.key ?? "fraction"}`] * part.spectrum[w];
        } else if (part.kind === "mixture") {
          let left = 1, sum = 0;
          part.names.forEach((name, k) => {
            if (name === part.rest) return;
            const share = p[`${part.path}.parts.${name}.share`];
            left -= share;
            sum += share * part.spectra[k][w];
          });
          const rest = part.names.indexOf(part.rest);
          if (rest >= 0) sum += left * part.spectra[rest][w];
          total += p[part.path + ".fraction"] * sum;
        } else {
          total += part.spectrum[w];
        }
      }
      return total;
    });
  }

  /** Cubic Hermite interpolation in ln x between the table's nodes, and whether they are valid. */
  function lookup(table, w, u) {
    const low = table.low[w], high = table.high[w], n = table.nodes;
    const h = (high - low) / (n - 1);
    const t = (u - low) / h;
    const inside = t >= table.first[w] - 1e-9 && t <= table.last[w] + 1e-9 && table.first[w] >= 0;
    const k = Math.max(0, Math.min(n - 2, Math.floor(t)));
    const s = Math.max(0, Math.min(1, t - k));
    const y = table.value[w], m = table.slope[w], e = table.error[w];
    const s2 = s * s, s3 = s2 * s;
    const value = y[k] * (2 * s3 - 3 * s2 + 1) + m[k] * h * (s3 - 2 * s2 + s)
      + y[k + 1] * (3 * s2 - 2 * s3) + m[k + 1] * h * (s3 - s2);
    return { value, error: e[k] * (1 - s) + e[k + 1] * s, inside };
  }

  /** What takes the rest of the layer gets what the others leave. */
  function fill(data, p) {
    if (data.rest) p[data.rest.path] = Math.max(0, 1 - data.rest.fixed - data.rest.others.reduce((s, path) => s + p[path], 0));
  }

  /** Reading of the instrument at each wavelength. */
  function evaluate(data, p) {
    const a = absorption(data, p);
    const factor = p["scattering.factor"] ?? 1, exponent = p["scattering.exponent"] ?? 0;
    return data.wavelength_nm.map((nm, w) => {
      const s = data.endless ? data.scattering_per_mm[w] * factor * Math.pow(nm / 500, -exponent) : 1;
      return lookup(data.table, w, Math.log(a[w] / s));
    });
  }

  const known = (v) => v !== null && Number.isFinite(v);

  function overMaximum(values) {
    const top = Math.max(...values.filter(known));
    return top > 0 ? values.map((v) => (known(v) ? v / top : null)) : values;
  }

  function compare(model, reference, scaling) {
    const at = reference.map((v, k) => k).filter((k) => known(reference[k]) && known(model[k]));
    let m = at.map((k) => model[k]), r = at.map((k) => reference[k]);
    if (scaling === "max") { m = overMaximum(m); r = overMaximum(r); }
    const n = at.length, mean = (x) => x.reduce((s, v) => s + v, 0) / n;
    const mm = mean(m), mr = mean(r);
    let square = 0, cross = 0, sm = 0, sr = 0;
    for (let k = 0; k < n; k++) {
      square += (m[k] - r[k]) ** 2;
      cross += (m[k] - mm) * (r[k] - mr);
      sm += (m[k] - mm) ** 2;
      sr += (r[k] - mr) ** 2;
    }
    return { rmse: Math.sqrt(square / n), pearson: n > 2 && sm > 0 && sr > 0 ? cross / Math.sqrt(sm * sr) : null, n };
  }

  function colourOf(data, values) {
    if (!data.colour) return null;
    return data.colour.map((row) => {
      const linear = row.reduce((s, weight, w) => s + weight * values[w], 0);
      const c = Math.max(0, Math.min(1, linear));
      return Math.round(255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * Math.pow(c, 1 / 2.4) - 0.055));
    });
  }

  /** Sum of what the last layer consists of: no tissue holds more than all of itself. */
  function contents(data, p) {
    return data.parts.reduce((s, part) => s + (part.path && p[part.path + ".fraction"] !== undefined ? p[part.path + ".fraction"] : 0), 0);
  }

  const toml = (v) => { const t = String(Number(v.toPrecision(8))); return /[.e]/.test(t) ? t : t + ".0"; };

  function config(data, p) {
    const lines = ["[tissue.set]"];
    for (const s of data.sliders) if (!s.path.startsWith("scattering.")) lines.push(`"${s.path}" = ${toml(p[s.path])}`);
    const factor = p["scattering.factor"] ?? 1, exponent = p["scattering.exponent"] ?? 0, law = data.law;
    if (law && law.kind === "cell" && factor !== 1) lines.push(`"${law.path}" = ${toml(law.fraction * factor)}`);
    if (law && law.kind === "power" && (factor !== 1 || exponent !== 0)) {
      const replaces = law.replaces ? `, replaces = "${law.replaces}"` : "";
      lines.push(`"${law.path}" = { kind = "power_law_scatterer", a_per_cm = ${toml(law.a_per_cm * factor)}, reference_nm = 500.0, `
        + `b = ${toml(law.b + exponent)}, anisotropy = ${toml(law.anisotropy)}${replaces} }`);
    }
    return lines.join("\n") + "\n";
  }

  function svg(tag, attributes, text) {
    const made = document.createElementNS(NS, tag);
    for (const [k, v] of Object.entries(attributes)) made.setAttribute(k, v);
    if (text !== undefined) made.textContent = text;
    return made;
  }

  function html(tag, attributes = {}, text) {
    const made = document.createElement(tag);
    for (const [k, v] of Object.entries(attributes)) made.setAttribute(k, v);
    if (text !== undefined) made.textContent = text;
    return made;
  }

  const shown = (v) => (v === null ? "–" : Math.abs(v) >= 100 ? v.toFixed(0) : String(Number(v.toPrecision(3))));

  function start(root) {
    const data = JSON.parse(root.querySelector("script[type='application/json']").textContent);
    const p = Object.fromEntries(data.sliders.map((s) => [s.path, s.value]));
    const form = root.querySelector(".bench-sliders"), plot = root.querySelector(".bench-plot");
    const patch = root.querySelector(".bench-patch"), scores = root.querySelector(".bench-scores");
    const note = root.querySelector(".bench-note"), out = root.querySelector(".bench-config");
    const scaling = root.querySelector(".bench-scaling");
    const inputs = [];
    const uid = root.id;

    data.sliders.forEach((s, k) => {
      const toValue = (t) => (s.log ? s.low * Math.pow(s.high / s.low, t / 1000) : s.low + (s.high - s.low) * t / 1000);
      const toPlace = (v) => Math.round(1000 * (s.log ? Math.log(v / s.low) / Math.log(s.high / s.low) : (v - s.low) / (s.high - s.low)));
      const row = html("div", { class: "bench-row" }), id = `${uid}-slider-${k}`;
      row.append(html("label", { for: id }, s.label));
      const input = html("input", { type: "range", id, min: 0, max: 1000, step: 1, "data-path": s.path });
      const value = html("output", { for: id });
      const tell = () => {
        value.textContent = `${shown(p[s.path])} ${s.unit}`.trim();
        input.setAttribute("aria-valuetext", value.textContent);
      };
      input.addEventListener("input", () => { p[s.path] = toValue(Number(input.value)); tell(); update(); });
      inputs.push(() => { input.value = toPlace(p[s.path]); tell(); });
      row.append(value, input);
      form.append(row);
    });

    function draw(values, valid, errors) {
      const W = 640, H = 330, L = 52, R = 12, T = 12, B = 44, x = data.wavelength_nm;
      const px = (nm) => L + (W - L - R) * (nm - x[0]) / Math.max(x[x.length - 1] - x[0], 1e-9);
      const max = scaling.value === "max";
      const model = max ? overMaximum(values) : values;
      const scale = max ? 1 / Math.max(...values) : 1;
      const curves = data.references.map((r) => (max ? overMaximum(r.value) : r.absolute ? r.value : []));
      const top = 1.06 * Math.max(1e-6, ...model.filter(known), ...curves.flat().filter(known));
      const py = (v) => H - B - (H - T - B) * v / top;
      const line = (ys) => ys.map((v, k) => (known(v) ? `${k && known(ys[k - 1]) ? "L" : "M"}${px(x[k]).toFixed(1)} ${py(v).toFixed(1)}` : "")).join("");
      plot.replaceChildren();
      const step = Math.pow(10, Math.floor(Math.log10(top))) / (top / Math.pow(10, Math.floor(Math.log10(top))) < 3 ? 5 : 2);
      for (let v = 0; v <= top; v += step) {
        plot.append(svg("line", { x1: L, x2: W - R, y1: py(v), y2: py(v), class: "grid" }));
        plot.append(svg("text", { x: L - 7, y: py(v) + 4, class: "tick", "text-anchor": "end" }, String(Number(v.toPrecision(3)))));
      }
      const ticks = Math.ceil((x[x.length - 1] - x[0]) / 8 / 50) * 50 || 50;
      for (let nm = Math.ceil(x[0] / ticks) * ticks; nm <= x[x.length - 1]; nm += ticks)
        plot.append(svg("text", { x: px(nm), y: H - B + 18, class: "tick", "text-anchor": "middle" }, String(nm)));
      plot.append(svg("text", { x: (L + W - R) / 2, y: H - 6, class: "tick", "text-anchor": "middle" }, "wavelength [nm]"));
      curves.forEach((c, k) => { if (c.length) plot.append(svg("path", { d: line(c), class: `reference r${k % 3}` })); });
      const up = model.map((v, k) => v + 2 * errors[k] * scale), down = model.map((v, k) => v - 2 * errors[k] * scale);
      const band = line(up) + down.map((v, k) => [k, v]).reverse().map(([k, v]) => `L${px(x[k]).toFixed(1)} ${py(v).toFixed(1)}`).join("") + "Z";
      plot.append(svg("path", { d: band, class: "band" }));
      plot.append(svg("path", { d: line(model), class: "model" }));
      model.forEach((v, k) => {
        if (!valid[k]) plot.append(svg("path", { d: `M${px(x[k]) - 4} ${py(v) - 4}l8 8m0 -8l-8 8`, class: "outside" }));
      });
    }

    function update() {
      const began = performance.now();
      fill(data, p);
      const found = evaluate(data, p);
      const values = found.map((f) => f.value), valid = found.map((f) => f.inside), errors = found.map((f) => f.error);
      draw(values, valid, errors);
      const rgb = colourOf(data, values);
      if (rgb) {
        patch.style.backgroundColor = `rgb(${rgb.join(" ")})`;
        patch.setAttribute("aria-label", `Colour under D65: red ${rgb[0]}, green ${rgb[1]}, blue ${rgb[2]} of 255`);
      }
      scores.replaceChildren();
      data.references.forEach((r, k) => {
        const c = compare(values, r.value, scaling.value === "max" || !r.absolute ? "max" : "none");
        const row = html("tr");
        const name = html("th", { scope: "row" }, r.label);
        name.prepend(html("span", { class: `bench-key r${k % 3}`, "aria-hidden": "true" }));
        row.append(name, html("td", { class: "num" }, c.rmse.toFixed(4)), html("td", { class: "num" }, c.pearson === null ? "–" : c.pearson.toFixed(4)));
        scores.append(row);
      });
      const told = [], outside = valid.filter((v) => !v).length, full = contents(data, p);
      if (full > 1 + 1e-9) told.push(`The contents add to ${full.toFixed(3)}: there is no such tissue.`);
      if (outside) told.push(`At ${outside} of ${valid.length} wavelengths (crosses) this lies beyond what the recorded walk can answer for: record anew with the copied values.`);
      note.textContent = told.join(" ");
      note.hidden = !told.length;
      out.textContent = config(data, p);
      root.bench = { values, valid, errors, rgb, parameters: { ...p }, config: out.textContent, milliseconds: performance.now() - began };
    }

    scaling.addEventListener("change", update);
    root.querySelector(".bench-reset").addEventListener("click", () => {
      for (const s of data.sliders) p[s.path] = s.value;
      inputs.forEach((f) => f());
      update();
    });
    const copy = root.querySelector(".bench-copy");
    copy.addEventListener("click", async () => {
      let done = false;
      try { await navigator.clipboard.writeText(out.textContent); done = true; } catch (_) {
        const range = document.createRange();
        range.selectNodeContents(out);
        const selection = getSelection();
        selection.removeAllRanges();
        selection.addRange(range);
        try { done = document.execCommand("copy"); } catch (_e) { done = false; }
      }
      root.querySelector(".bench-status").textContent = done ? "Copied." : "Selected below: copy it by hand.";
      if (!done) out.closest("details").open = true;
    });
    root.evaluate = (given) => evaluate(data, { ...p, ...given });
    inputs.forEach((f) => f());
    update();
  }

  document.querySelectorAll("[data-bench]").forEach(start);
})();
