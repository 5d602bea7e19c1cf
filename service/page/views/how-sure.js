// How sure: the probability of ricochet of a case whose inputs scatter, and its sensitivity to them.

import { caseQuery, readCase, replaceAddress } from "../address.js";
import { nodeAt } from "../contract.js";
import { announce, element } from "../elements.js";
import { SAMPLING } from "../fields.js";
import { CaseForm } from "../form.js";
import { lostNote } from "../lost.js";
import { purge } from "../plots.js";
import { readInputs, usualInputs, writeInput } from "../scatter.js";
import { ScatterForm } from "../scatter-form.js";
import { isAbort } from "../service.js";
import { markFresh, markPending, markSettled, markStale } from "../stale.js";
import { computeStudy } from "../study.js";
import { describeStudy, drawCurve, drawTornado, sensitivityTable } from "../study-plots.js";
import { Verdict } from "../verdict.js";
import { grouped, warningList } from "../words.js";

const REST_MS = 800; // pause without a change before the study runs again

/** Show the view; the study starts automatically, and again when its inputs change. */
export async function show(root, query) {
  const view = new HowSure(root, query);
  return () => view.leave();
}

class HowSure {
  #work; // AbortController of the study, aborted when the form changes
  #timer; // of the pause before the study runs again
  #refused = new Set(); // forms with a field that is not accepted

  constructor(root, query) {
    this.verdict = new Verdict({
      onError: (error) => {
        this.form.fail(error);
        if (this.isDue) this.#run();
      },
      onJudged: ({ keys }) => {
        this.isJudged = true;
        if (this.isUsual) this.scatter.setInputs(usualInputs(this.form.currentCase()));
        this.#readdress();
        if (this.isDue) this.#run(keys.uncertainty);
      },
    });
    this.parts = build(root, this.verdict.root, () => this.#run(), () => this.#stop("Stopped."), () => this.#showResults());
    const inputs = readInputs(query);
    const values = readCase(query);
    this.sampling = readSampling(query);
    this.isUsual = !inputs; // whether the usual scatter is used, until an input is edited
    const onChange = () => {
      this.isUsual = false;
      this.#change();
    };
    this.scatter = new ScatterForm(this.parts.scatter, { inputs: inputs ?? usualInputs(values), values, onChange });
    this.form = new CaseForm(this.parts.others, {
      case: values,
      onChange: (changed, path) => {
        this.#refused.delete("case");
        if (path === "impact.oblique_angle_deg") return this.#turn(changed);
        this.isJudged = false;
        this.scatter.setCase(changed);
        this.verdict.setCase(changed);
        return this.#change();
      },
      onHold: () => this.#hold("case"),
      problem: this.parts.problem,
      panels: [this.verdict],
    });
    this.samplingForm = new CaseForm(this.parts.sampling, {
      case: { sampling: this.sampling },
      groups: [SAMPLING],
      open: [],
      onChange: ({ sampling = {} }) => {
        this.#refused.delete("sampling");
        this.sampling = sampling;
        this.#change();
      },
      onHold: () => this.#hold("sampling"),
      problem: this.parts.problem,
    });
    this.verdict.setCase(values);
    if (inputs) this.#run();
    else this.#change();
  }

  leave() {
    this.#work?.abort();
    clearTimeout(this.#timer);
    this.verdict.stop();
    purge(this.parts.curve);
    purge(this.parts.tornado);
  }

  #hold(form) {
    this.#refused.add(form);
    this.#change();
  }

  /** Show the probability at another oblique angle; the study covers all angles. */
  #turn(values) {
    this.verdict.setCase(values);
    if (this.study) drawCurve(this.parts.curve, this.study, values);
    this.#readdress();
  }

  #change() {
    this.#stop("");
    clearTimeout(this.#timer);
    this.study = undefined;
    const { parts } = this;
    markPending(parts.run);
    parts.problem.textContent = "";
    const isRight = Boolean(this.scatter.inputs?.length) && !this.#refused.size;
    parts.run.disabled = !isRight;
    if (!isRight) announce("A field is not accepted. Nothing is computed.", true);
    if (!isRight) parts.results.hidden = parts.toResults.hidden = true; // there are no results for a field that is not accepted
    if (!parts.results.hidden) {
      parts.progress.textContent = "Results are for the previous inputs.";
      markStale(parts.results);
    }
    this.isDue = isRight && this.isUsual && !this.isJudged; // the verdict gives the usual scatter, and the key of a study with it
    if (this.isDue) parts.progress.textContent = "Computing ...";
    else if (isRight) this.#timer = setTimeout(() => this.#run(), REST_MS);
    this.#readdress();
  }

  #readdress() {
    const inputs = this.scatter.inputs;
    if (!inputs || this.#refused.size) return;
    const query = caseQuery(this.form.currentCase());
    const isKnown = !this.isUsual || this.isJudged; // otherwise the inputs may be those of another case
    for (const input of isKnown ? inputs : []) query.append("scatter", writeInput(input));
    for (const [name, value] of Object.entries(this.sampling)) query.set(`sampling.${name}`, value);
    replaceAddress("how-sure", query);
  }

  /** Compute the study; `key` names the study of the verdict, if that has the same inputs. */
  async #run(key) {
    const inputs = this.scatter.inputs;
    if (!inputs?.length || this.#refused.size) return;
    this.#change();
    this.isDue = false;
    clearTimeout(this.#timer);
    const work = new AbortController();
    this.#work = work;
    const { parts } = this;
    parts.stop.disabled = false;
    parts.progress.textContent = "Computing ...";
    announce("Computing ...");
    try {
      const study = { values: this.form.currentCase(), inputs, sampling: this.sampling };
      if (!Object.keys(this.sampling).length) study.key = key;
      for await (const answer of computeStudy(study, work.signal)) {
        if (work.signal.aborted) return;
        await this.#show(answer, study.values, work.signal);
      }
      if (!work.signal.aborted) this.#stop("Done.");
    } catch (error) {
      if (isAbort(error) || work.signal.aborted) return;
      this.#stop("");
      parts.progress.textContent = "";
      this.#fail(error);
    }
  }

  /** Show an answer, or the number of samples and the curve so far. */
  async #show(study, values, signal) {
    const { parts } = this;
    parts.progress.textContent = `${grouped(study.samples)} samples ...`;
    if (!study.probability) return;
    parts.results.hidden = parts.toResults.hidden = false;
    parts.answerPanel.hidden = parts.sensitivity.hidden = !study.critical_angle;
    if (study.critical_angle) this.study = study;
    await drawCurve(parts.curve, study, this.form.currentCase());
    if (study.critical_angle) {
      parts.answer.replaceChildren(...describeStudy(study));
      parts.warnings.hidden = !study.warnings.length;
      parts.warnings.replaceChildren(...warningList(study.warnings));
      parts.table.replaceChildren(sensitivityTable(study));
      await drawTornado(parts.tornado, study, values);
    } // otherwise the job is still running
    if (this.#work?.signal === signal) markFresh(parts.results);
  }

  /** Scroll to the results, which may be far below in a long form. */
  #showResults() {
    this.parts.results.scrollIntoView();
    this.parts.results.focus({ preventScroll: true });
  }

  #stop(text) {
    this.#work?.abort();
    this.#work = undefined;
    this.parts.stop.disabled = true;
    if (text) this.parts.progress.textContent = text;
    announce("");
    if (text) markSettled(this.parts.run, text === "Done." ? undefined : "");
  }

  #fail(error) {
    if (!error.errors?.length) return this.form.fail(error);
    const { true: ofSampling, false: others } = Object.groupBy(this.scatter.showProblems(error.errors), ({ pointer }) => pointer.startsWith("/sampling"));
    if (ofSampling) this.samplingForm.fail({ errors: ofSampling });
    return others && this.form.fail({ errors: others });
  }
}

function readSampling(query) {
  const given = SAMPLING.fields.map(({ path }) => [path.split(".")[1], query.get(path)]);
  const isNumber = ([, text]) => text && Number.isFinite(Number(text));
  return Object.fromEntries(given.filter(isNumber).map(([name, text]) => [name, Number(text)]));
}

function build(root, verdict, onRun, onStop, onResults) {
  const { default: confidence } = nodeAt("sampling.confidence", {});
  const parts = {
    scatter: element("div"),
    others: element("div"),
    sampling: element("div"),
    run: element("button.main", { type: "submit", form: "scatter" }, "Run"),
    stop: element("button", { type: "button", disabled: true, onclick: onStop }, "Stop"),
    toResults: element("button", { type: "button", hidden: true, onclick: onResults }, "Show the results"),
    progress: element("p.quiet", { id: "study-progress", "aria-live": "polite" }),
    problem: element("p.problem", { role: "alert" }),
    answer: element("div.outcome"),
    warnings: element("section.panel", { "aria-label": "Warnings", hidden: true }),
    curve: element("div.curve"),
    tornado: element("div.tornado"),
    table: element("div"),
  };
  const onsubmit = (event) => {
    event.preventDefault();
    onRun();
  };
  const about = element("p.quiet", {}, "A mean, median or mode left empty is the value of the case.");
  const scatterForm = element(
    "form.panel",
    { id: "scatter", novalidate: true, "aria-label": "What scatters", onsubmit },
    element("h2", {}, "What scatters"),
    about,
    parts.scatter,
    parts.sampling,
  );
  const buttons = element("p.actions", {}, parts.run, parts.stop, parts.toResults);
  const start = element("section.panel", { "aria-label": "Study" }, buttons, parts.progress, parts.problem, lostNote());
  const others = element("details", {}, element("summary", {}, "The case"), parts.others);
  const band = `The band is the sampling error, at a confidence of ${100 * confidence} %: more samples make it narrower, but the inputs no more certain.`;
  const swing = "Each input goes from its 5 % to its 95 % quantile, with the others at their median or most likely value.";
  parts.answerPanel = element("section.panel", { "aria-label": "Answer", hidden: true }, parts.answer);
  parts.sensitivity = element(
    "section.panel",
    { hidden: true },
    element("h2", {}, "What it is sensitive to"),
    element("p.quiet", {}, swing),
    parts.tornado,
    parts.table,
  );
  parts.results = element(
    "div.column",
    { hidden: true, tabindex: -1 },
    parts.answerPanel,
    element("section.panel", {}, element("h2", {}, "Probability of ricochet"), element("p.quiet", {}, band), parts.curve),
    parts.sensitivity,
    parts.warnings,
  );
  root.append(
    element("h1", {}, "How sure"),
    element(
      "div.sides",
      {},
      element("div.column", {}, scatterForm, element("div.panel", {}, others)),
      element("div.column", {}, verdict, start, parts.results),
    ),
  );
  return parts;
}
