import type { Info, OptionInfo, Options } from '../api/types';
import { byId, make } from './dom';

/** Options with a control of their own, or that the page sets itself. */
const OWN = [
  'style',
  'energy',
  'seed',
  'offset_s',
  'duration_s',
  'format',
  'include',
  'encoding',
  'music',
  'continue_from',
  'positions',
  'mirror',
  'rig',
  'codes',
  // A stream has no loop: it would have to know its end first.
  'loop',
  'bars',
];
/** Options that change the file but not the dance, and the formats that have them: all, or these. */
const OF_FILES: Record<string, string[] | null> = {
  fps: null,
  bvh_unit: ['bvh'],
  skeleton: ['bvh', 'glb', 'fbx'],
  mannequin: ['glb'],
};
type Control = HTMLInputElement | HTMLSelectElement;

/** The options of a generation: the usual ones, and whatever else the server offers. */
export class OptionsForm {
  private readonly dance: Control[] = [];
  private readonly file: Control[] = [];
  private offered = new Set<string>();
  private styles: string[] = [];

  constructor() {
    byId<HTMLInputElement>('energy').addEventListener('input', () => {
      byId<HTMLInputElement>('energy-auto').checked = false;
    });
  }

  /** Builds the controls of what the server offers. */
  fill(info: Info): void {
    this.offered = new Set(info.options.map((option) => option.name));
    this.styles = (info.styles ?? []).map((style) =>
      typeof style === 'string' ? style : style.name,
    );
    if (this.styles.length === 0) {
      const option = info.options.find(({ name }) => name === 'style');
      this.styles = choices(option).filter((style) => style !== 'auto');
    }
    const hasStyles = this.offered.has('style') && this.styles.length > 0;
    byId('style-field').hidden = !hasStyles;
    byId('vary-field').hidden = !hasStyles;
    // Every server has the option; only some models know what to do with it.
    byId('energy-field').hidden = !this.offered.has('energy') || info.model.energy === false;
    byId('style').replaceChildren(
      make('option', { value: '', textContent: 'by the music' }),
      ...this.styles.map((style) => make('option', { value: style, textContent: style })),
    );
    const rest = info.options.filter(({ name }) => !OWN.includes(name));
    this.build(
      byId('options'),
      this.dance,
      rest.filter(({ name }) => !(name in OF_FILES)),
    );
    this.build(
      byId('file-options'),
      this.file,
      rest.filter(({ name }) => name in OF_FILES),
    );
    byId('more').hidden = this.dance.length === 0;
    byId('format').replaceChildren(
      ...info.formats.map(({ name }) =>
        make('option', { value: name, textContent: name.toUpperCase() }),
      ),
    );
  }

  /** Whether the server offers an option. */
  offers(name: string): boolean {
    return this.offered.has(name);
  }

  /** Options of each dancer that is asked for. */
  dancers(): Options[] {
    const count = Number(document.querySelector<HTMLInputElement>('[name=count]:checked')?.value);
    const shared = this.shared();
    const byStyle = !byId('vary-field').hidden && value('vary') === 'style';
    const first = Number(shared.seed);
    return Array.from({ length: count }, (_, i) => {
      const options = { ...shared };
      if (byStyle && count > 1) {
        const from = Math.max(this.styles.indexOf(shared.style), 0);
        options.style = this.styles[(from + i) % this.styles.length];
      } else if (shared.seed !== undefined && Number.isInteger(first)) {
        options.seed = String(first + i);
      }
      return options;
    });
  }

  /** Shows the options that a format has. */
  fit(format: string): void {
    for (const { name, parentElement } of this.file)
      parentElement!.hidden = !(OF_FILES[name]?.includes(format) ?? true);
  }

  /** Options of the file that is downloaded. */
  ofFile(): Options {
    return read(this.file.filter(({ parentElement }) => !parentElement!.hidden));
  }

  private shared(): Options {
    const options = read(this.dance);
    const put = (name: string, text: string) => {
      if (text !== '') options[name] = text;
    };
    put('seed', value('seed'));
    put('offset_s', value('offset').replace(',', '.'));
    put('duration_s', value('length').replace(',', '.'));
    if (!byId('style-field').hidden) put('style', value('style'));
    const auto = byId<HTMLInputElement>('energy-auto').checked;
    if (!byId('energy-field').hidden && !auto) put('energy', value('energy'));
    return options;
  }

  private build(parent: HTMLElement, controls: Control[], options: OptionInfo[]): void {
    controls.splice(0);
    parent.replaceChildren(
      ...options.map((option) => {
        const control = controlOf(option);
        controls.push(control);
        const label = make('label', { htmlFor: control.id, textContent: words(option.name) });
        label.title = `${option.description} Accepts ${option.accepts}; default: ${option.default}.`;
        return make('div', { className: 'field' }, label, control);
      }),
    );
  }
}

function value(id: string): string {
  return byId<HTMLInputElement>(id).value.trim();
}

function read(controls: Control[]): Options {
  const set = controls.filter((control) => control.value.trim() !== '');
  return Object.fromEntries(set.map((control) => [control.name, control.value.trim()]));
}

function controlOf(option: OptionInfo): Control {
  const common = { id: `option-${option.name}`, name: option.name };
  const values = choices(option);
  // Without its exceptions, which the title of the label has: `true, false with rig`.
  const usual = option.default.split(/[,;]/)[0];
  if (values.length === 0) return make('input', { ...common, placeholder: usual });
  const select = make('select', common, make('option', { value: '', textContent: usual }));
  const others = values.filter((one) => one !== usual);
  select.append(...others.map((one) => make('option', { value: one, textContent: one })));
  return select;
}

/** Values of an option that has a few: `one of a, b` or `true or false`. */
function choices(option: OptionInfo | undefined): string[] {
  const accepts = option?.accepts ?? '';
  if (accepts === 'true or false') return ['true', 'false'];
  const list = /^one of (.+)$/.exec(accepts)?.[1];
  return list ? list.split(/,\s*(?:or\s+)?|\s+or\s+/) : [];
}

function words(name: string): string {
  const text = name
    .replaceAll('_', ' ')
    .replace(/ s$/, ' (s)')
    .replace(/^(fps|bvh)\b/, (word) => word.toUpperCase());
  return text[0].toUpperCase() + text.slice(1);
}
