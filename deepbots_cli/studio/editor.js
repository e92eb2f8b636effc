// The text editor of the studio. Positions are a line from 0 and a column in UTF-16 units.
//
// A text is sent with the revision that it is based on. While the answer is awaited, no further text is sent.
// If the server has another text by then, it answers with it: changes at other places are kept on both sides, and
// where both changed the same place, the person chooses.
//
// The storage of the browser keeps a text that is not saved, and it is offered when the file is shown again.
import * as CM from "nicegui-codemirror";

const SEND_AFTER_MS = 60;
const FLASH_MS = 6000; // of the animation in studio.css
const OFFLINE_AFTER_MS = 1500;
const OFFLINE = "The studio does not answer: its server has ended, or the connection is lost. Go on writing: this " +
  "browser keeps the text. If the server has ended, start it again with `deepbots studio`, and open its address.";
const TEXT_FIELD = "input:not([readonly], [type=checkbox], [type=range]), textarea, [contenteditable=true]";
const OFFER = "This browser kept an unsaved text of this file.";
const BOTH_CHANGED = "This place was also changed by a button or in another browser.";
const WRAPPED_FROM = 20; // letters; a shorter line is never wrapped
// Colors of CodeMirror's two styles, and what the page has instead: quieter comments, and keys that are not red.
const LIGHT = CM.syntaxHighlighting(recolored(CM.defaultHighlightStyle, { "#940": "#5b6774", "#00c": "#0b57a4" }));
const DARK = [CM.oneDarkTheme, CM.syntaxHighlighting(recolored(CM.oneDarkHighlightStyle,
  { "#e06c75": "#8fc1f5", "#7d8799": "#95a0ae" }))];
const setMarks = CM.StateEffect.define();
const marks = CM.StateField.define({
  create: () => CM.Decoration.none,
  update(set, transaction) {
    set = set.map(transaction.changes);
    for (const effect of transaction.effects) if (effect.is(setMarks)) set = effect.value;
    return set;
  },
  provide: (field) => CM.EditorView.decorations.from(field),
});
// The rest of a long line is indented as its start, and by two letters more.
const hanging = CM.StateField.define({
  create: (state) => hangingLines(state.doc),
  update: (set, transaction) => transaction.docChanged ? hangingLines(transaction.state.doc) : set,
  provide: (field) => CM.EditorView.decorations.from(field),
});
const setFlash = CM.StateEffect.define();
const flashed = CM.StateField.define({
  create: () => CM.Decoration.none,
  update(set, transaction) {
    set = set.map(transaction.changes);
    for (const effect of transaction.effects) if (effect.is(setFlash)) set = effect.value;
    return set;
  },
  provide: (field) => CM.EditorView.decorations.from(field),
});
const fromServer = CM.Annotation.define();

function element(tag, className, ...children) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  made.append(...children);
  return made;
}

function hangingLines(doc) {
  const ranges = [];
  for (let number = 1; number <= doc.lines; number++) {
    const { from, text } = doc.line(number);
    const indent = /^ */.exec(text)[0].length + 2;
    const style = `padding-left: calc(6px + ${indent}ch); text-indent: -${indent}ch`;
    if (text.length > WRAPPED_FROM) ranges.push(CM.Decoration.line({ attributes: { style } }).range(from));
  }
  return CM.Decoration.set(ranges);
}

// The few forms of Markdown in hover texts and completions; all text is set as text, never as HTML.
function markdown(text) {
  const root = element("div", "studio-markdown");
  text.split(/```[a-z]*\n?/).forEach((part, number) => {
    if (number % 2) return root.append(element("pre", "", part.trimEnd()));
    for (const paragraph of part.split(/\n\s*\n/)) {
      if (!paragraph.trim()) continue;
      const p = element("p", "");
      paragraph.split(/(`[^`]+`|\*\*[^*]+\*\*)/).forEach((piece) => {
        if (piece.startsWith("`")) p.append(element("code", "", piece.slice(1, -1)));
        else if (piece.startsWith("**")) p.append(element("b", "", piece.slice(2, -2)));
        else p.append(piece);
      });
      root.append(p);
    }
  });
  return root;
}

async function ask(what, body) {
  const answer = await fetch(`studio/${what}`, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
  return answer.ok ? answer.json() : null;
}

export default {
  template: `<div class="studio-editor"></div>`,
  data: () => ({ path: "", revision: 0, base: "", waiting: false, other: null, offered: null,
    afterwards: "", timer: 0, findings: [], offline: false }),
  mounted() {
    this.bar = element("div", "studio-banner");
    this.bar.setAttribute("role", "alert");
    this.bar.hidden = true;
    this.$el.append(this.bar);
    this.dark = new CM.Compartment();
    this.writing = new CM.Compartment();
    this.language = new CM.Compartment();
    const keys = CM.keymap.of([
      { key: "Mod-s", preventDefault: true, run: () => this.command("save") },
      { key: "Mod-Enter", preventDefault: true, run: () => this.command("train") },
      { key: "F1", preventDefault: true, run: () => this.command("explain") },
      { key: "F8", preventDefault: true, run: () => this.nextFinding() },
      { key: "Alt-Tab", run: CM.indentMore },
    ]);
    // One object: CodeMirror compares sources of completions, and asks a new one again and again.
    const completions = [{ autocomplete: (context) => this.complete(context) }];
    this.extensions = [
      CM.Prec.highest(keys),
      CM.basicSetup,
      CM.EditorView.lineWrapping,
      CM.EditorState.tabSize.of(2),
      CM.indentUnit.of("  "),
      CM.Prec.highest(CM.indentService.of(indentation)),
      this.language.of([]),
      this.dark.of(LIGHT),
      this.writing.of([]),
      marks,
      flashed,
      hanging,
      CM.EditorState.languageData.of(() => completions),
      CM.hoverTooltip((view, position) => this.describe(view, position), { hoverTime: 350, hideOnChange: true }),
      CM.EditorView.contentAttributes.of({ "aria-label": "text of the scenario", tabindex: "0" }),
      CM.EditorView.updateListener.of((update) => {
        if (!update.docChanged) return;
        this.keep();
        if (!update.transactions.some((each) => each.annotation(fromServer))) this.schedule();
      }),
    ];
    this.view = new CM.EditorView({ parent: this.$el, extensions: this.extensions });
    // A finding that appears below the text must not cover the line that is being written.
    this.resized = new ResizeObserver(() => {
      const { head } = this.view.state.selection.main;
      if (this.view.hasFocus) this.view.dispatch({ effects: CM.EditorView.scrollIntoView(head, { yMargin: 24 }) });
    });
    this.resized.observe(this.view.scrollDOM);
    this.lost = () => { this.offlineTimer = setTimeout(() => this.setOffline(true), OFFLINE_AFTER_MS); };
    this.found = () => { clearTimeout(this.offlineTimer); this.setOffline(false); };
    window.addEventListener("keydown", this.keyElsewhere, true);
    const yaml = CM.languages.find((each) => each.name == "YAML");
    yaml.load().then((support) => {
      this.yaml = support;
      this.view.dispatch({ effects: this.language.reconfigure(support) });
    });
  },
  beforeUnmount() {
    clearTimeout(this.timer);
    window.socket?.off("disconnect", this.lost);
    window.socket?.off("connect", this.found);
    window.removeEventListener("keydown", this.keyElsewhere, true);
    this.resized.disconnect();
    this.view.destroy();
  },
  methods: {
    // The keys of the editor while something else has the focus, such as the button that was pressed last.
    keyElsewhere(event) {
      const target = event.target instanceof Element ? event.target : document.body;
      if (!(event.ctrlKey || event.metaKey) || event.altKey || this.view.contentDOM.contains(target)) return;
      const key = event.key == "Enter" ? "enter" : event.key.toLowerCase() + (event.shiftKey ? "+shift" : "");
      const edit = { "z": CM.undo, "y": CM.redo, "z+shift": CM.redo }[key];
      const inDialog = target.closest(".q-dialog");
      if (key == "s") this.command("save");
      else if (key == "enter" && !inDialog) this.command("train");
      else if (edit && !inDialog && !target.matches(TEXT_FIELD)) {
        this.view.focus();
        edit(this.view);
      } else return;
      event.preventDefault();
      event.stopImmediatePropagation();
    },
    command(name) {
      if (this.other) return true; // the person chooses a text first
      if (this.waiting && this.text() != this.sent) { // the last letters go first
        this.afterwards = name;
        return true;
      }
      this.send();
      this.$emit("command", name);
      return true;
    },
    show(path, text, revision, readOnly, dark) {
      if (!this.listens && window.socket) { // there is none yet when the editor is mounted
        this.listens = true;
        window.socket.on("disconnect", this.lost);
        window.socket.on("connect", this.found);
      }
      this.leave();
      clearTimeout(this.timer);
      Object.assign(this, { path, revision, base: text, waiting: false, other: null, afterwards: "",
        findings: [] });
      this.view.setState(CM.EditorState.create({ doc: text, extensions: this.extensions }));
      this.view.scrollDOM.scrollTo(0, 0);
      this.view.dispatch({ effects: [
        this.language.reconfigure(this.yaml ?? []),
        this.writing.reconfigure(CM.EditorState.readOnly.of(readOnly)),
        this.dark.reconfigure(dark ? DARK : LIGHT) ] });
      const kept = this.kept();
      this.offered = typeof kept == "string" && kept != text && !readOnly ? kept : null;
      this.showBar();
    },
    // Text that is not saved
    say(text, ...buttons) {
      this.bar.replaceChildren(element("span", "", text), ...buttons.map(([label, act]) => {
        const button = element("button", "studio-plain-button", label);
        button.addEventListener("click", act);
        return button;
      }));
      this.bar.hidden = !text;
    },
    showBar() {
      if (this.offline) this.say(OFFLINE);
      else if (this.other)
        this.say(BOTH_CHANGED, ["Keep what I typed", () => this.choose(null)],
          ["Take the other text", () => this.choose(this.other.text)]);
      else if (this.offered != null)
        this.say(OFFER, ["Use it", () => this.useKept(true)], ["Discard it", () => this.useKept(false)]);
      else this.say("");
    },
    setOffline(offline) {
      if (offline == this.offline) return;
      this.offline = offline;
      this.showBar();
    },
    keep() {
      if (!this.path || this.offered != null) return;
      try { localStorage.setItem(storageKey(this.path), this.text()); } catch { /* the storage is full or forbidden */ }
    },
    kept() {
      try { return localStorage.getItem(storageKey(this.path)); } catch { return null; /* forbidden */ }
    },
    forget(path) {
      try { localStorage.removeItem(storageKey(path)); } catch { /* forbidden */ }
    },
    useKept(use) {
      const text = this.offered;
      this.offered = null;
      if (use) this.view.dispatch({ changes: difference(this.text(), text) ?? [] });
      else this.forget(this.path);
      this.showBar();
      this.view.focus();
    },
    markSaved(saved) {
      if (saved && this.text() == this.base && this.offered == null) this.forget(this.path);
    },
    setDark(dark) {
      this.view.dispatch({ effects: this.dark.reconfigure(dark ? DARK : LIGHT) });
    },
    text() {
      return this.view.state.doc.toString();
    },
    // Text to the server
    schedule() {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.send(), SEND_AFTER_MS);
    },
    send() {
      const text = this.text();
      if (!this.path || this.waiting || this.other || text == this.base) return;
      this.waiting = true;
      this.sent = text;
      this.$emit("change", this.path, this.revision, text);
    },
    // Send what was typed last into a file that is no longer shown. The browser keeps it until it has arrived.
    leave() {
      const text = this.text();
      if (!this.path || this.other || text == this.base) return;
      if (this.waiting && text != this.sent) this.$emit("change", this.path, this.revision + 1, text);
      else this.send();
    },
    // The answer to a text that was sent; `text` is null if the server has taken it
    confirm(path, revision, text) {
      if (path != this.path) return;
      this.waiting = false;
      if (text == null) Object.assign(this, { base: this.sent, revision });
      else this.rebase(text, revision);
      if (text == null && this.text() != this.base) this.schedule();
      const name = this.afterwards;
      this.afterwards = "";
      if (name) this.command(name);
    },
    // Text from the server. While an answer is awaited, it brings the newest one.
    receive(path, text, revision) {
      if (path == this.path && !this.waiting && revision > this.revision) this.rebase(text, revision);
    },
    // Replace the base by a newer text, and keep what was typed since.
    rebase(text, revision) {
      const changes = difference(this.base, text);
      const typed = difference(this.base, this.text());
      this.other = null;
      if (changes && typed && text != this.text()) {
        if (changes.from > typed.to) {
          const moved = typed.insert.length - (typed.to - typed.from);
          changes.from += moved;
          changes.to += moved;
        } else if (changes.to >= typed.from) this.other = { text, revision };
      }
      if (!this.other) {
        const isHere = text == this.text();
        Object.assign(this, { base: text, revision });
        if (changes && !isHere) this.view.dispatch({ changes, annotations: fromServer.of(true) });
        if (changes && this.text() != this.base) this.schedule();
      }
      this.showBar();
    },
    // Go on with what was typed, or with a text of the server.
    choose(text) {
      Object.assign(this, { base: this.other.text, revision: this.other.revision, other: null });
      if (text != null) this.view.dispatch({ changes: difference(this.text(), text) ?? [] });
      this.schedule();
      this.showBar();
      this.view.focus();
    },
    // Findings
    underline(revision, findings) {
      this.findings = findings;
      const doc = this.view.state.doc;
      const ranges = [];
      for (const finding of findings) {
        let from = this.offset(finding.start);
        let to = this.offset(finding.end);
        if (to <= from) to = Math.min(doc.length, from + 1);
        if (to <= from) from = Math.max(0, to - 1);
        if (to > from)
          ranges.push(CM.Decoration.mark({ class: `studio-${finding.severity}`, finding }).range(from, to));
      }
      this.view.dispatch({ effects: setMarks.of(CM.Decoration.set(ranges, true)) });
    },
    offset([line, column]) {
      const doc = this.view.state.doc;
      if (line >= doc.lines) return doc.length;
      const at = doc.line(line + 1);
      return Math.min(at.to, at.from + column);
    },
    place(offset) {
      const line = this.view.state.doc.lineAt(offset);
      return { line: line.number - 1, column: offset - line.from };
    },
    goTo(line, column) {
      const anchor = this.offset([line, column]);
      this.view.dispatch({ selection: { anchor },
        effects: CM.EditorView.scrollIntoView(anchor, { y: "center" }) });
      this.view.focus();
    },
    // Mark lines that the studio has changed, until an animation ends; the first one is scrolled to.
    flash(lines) {
      const doc = this.view.state.doc;
      const places = [...new Set(lines)].filter((line) => line < doc.lines).sort((a, b) => a - b)
        .map((line) => doc.line(line + 1).from);
      if (!places.length) return;
      const mark = CM.Decoration.line({ class: "studio-flash" });
      this.view.dispatch({ effects: [
        setFlash.of(CM.Decoration.set(places.map((from) => mark.range(from)))),
        CM.EditorView.scrollIntoView(places[0], { y: "nearest", yMargin: 60 })] });
      clearTimeout(this.flashTimer);
      this.flashTimer = setTimeout(() =>
        this.view.dispatch({ effects: setFlash.of(CM.Decoration.none) }), FLASH_MS);
    },
    // The text, the cursor, and what is selected or the word at the cursor
    cursor() {
      const { from, to, head } = this.view.state.selection.main;
      const range = from == to ? this.view.state.wordAt(head) : { from, to };
      const selected = range ? this.view.state.sliceDoc(range.from, range.to) : "";
      const word = selected.includes("\n") ? "" : selected.trim();
      return { text: this.text(), word, ...this.place(range ? range.from : head) };
    },
    nextFinding() {
      const at = this.view.state.selection.main.head;
      const starts = this.findings.map((each) => this.offset(each.start)).sort((a, b) => a - b);
      if (!starts.length) return true;
      const next = starts.find((each) => each > at) ?? starts[0];
      const { line, column } = this.place(next);
      this.goTo(line, column);
      return true;
    },
    // Completion and hover
    async complete(context) {
      const path = this.path;
      const answer = await ask("complete", { path, text: this.text(), ...this.place(context.pos) });
      if (!answer?.options.length || context.aborted || path != this.path) return null;
      const line = context.state.doc.lineAt(context.pos);
      const from = line.from + Math.min(...answer.options.map((option) => option.start));
      const typed = context.state.sliceDoc(from, context.pos);
      const fitting = answer.options.filter((option) => option.apply.startsWith(typed));
      const isFinished = fitting.length == 1 && fitting[0].apply == typed;
      if (!context.explicit && (!typed.trim() || isFinished)) return null;
      return {
        from,
        options: answer.options.map((option, number) => ({
          label: option.label, detail: option.detail, type: option.kind, boost: -number / 1000,
          info: option.info ? () => markdown(option.info) : undefined,
          apply: (view, _completion, start, end) => view.dispatch({
            changes: { from: line.from + option.start, to: end, insert: option.apply },
            selection: { anchor: line.from + option.start + option.apply.length } }),
        })),
      };
    },
    async describe(view, position) {
      const here = [];
      view.state.field(marks).between(position, position, (from, to, value) => {
        here.push({ from, to, finding: value.spec.finding });
      });
      const answer = await ask("hover", { path: this.path, text: this.text(), ...this.place(position) });
      if (!here.length && !answer) return null;
      const start = here.length ? here[0].from : this.offset(answer.start);
      const end = here.length ? here[0].to : this.offset(answer.end);
      return { pos: start, end, above: true, create: () => {
        const dom = element("div", "studio-hover");
        for (const { finding } of here)
          dom.append(element("p", `studio-message studio-message-${finding.severity}`,
            element("b", "", finding.code), ` ${finding.message}`));
        if (answer) dom.append(markdown(answer.text));
        return { dom };
      } };
    },
  },
};

// A new line is indented as the line before, and deeper below a key without a value. The parser of YAML in
// CodeMirror returns to column 0 behind a comment.
function indentation(context, position) {
  const line = context.lineAt(position, -1);
  const before = line.text.slice(0, position - line.from);
  const deeper = /:\s*(#.*)?$/.test(before) ? context.unit : 0;
  return /^\s*/.exec(before)[0].length + deeper;
}

function recolored(style, colors) {
  return CM.HighlightStyle.define(style.specs.map((spec) => ({ ...spec, color: colors[spec.color] ?? spec.color })));
}

function storageKey(path) {
  return `deepbots-studio:${path}`;
}

// Return the one change that turns a text into another, null for equal texts.
function difference(before, after) {
  if (before == after) return null;
  let from = 0;
  const shorter = Math.min(before.length, after.length);
  while (from < shorter && before[from] == after[from]) from++;
  let tail = 0;
  while (tail < shorter - from && before[before.length - 1 - tail] == after[after.length - 1 - tail]) tail++;
  return { from, to: before.length - tail, insert: after.slice(from, after.length - tail) };
}
