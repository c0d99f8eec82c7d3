import { Vector3 } from 'three';
import { ACCENTS, SKIN } from './cast';
import { Dance, type DanceJson } from './motion/dance';
import { emptyPose } from './motion/skeleton';
import { Mannequin } from './scene/mannequin';
import { type Look, Stage } from './scene/stage';
import { byId } from './ui/dom';
import { VIEWS } from './ui/transport';

/** Colours behind the scene, from the middle outwards: as `--stage` in the style sheet. */
const BACKGROUNDS: Record<Look, [string, string]> = {
  light: ['#f7f5f0', '#e9e6df'],
  dark: ['#262a2f', '#181a1d'],
};

/** Draws a dance picture by picture for `bailando render`, which receives each. */
export async function film(asked: URLSearchParams): Promise<void> {
  const token = asked.get('film') ?? '';
  const to = (what: string) => new URL(`film/${token}/${what}`, document.baseURI);
  const send = async (what: string, body: Blob | string) => {
    const answer = await fetch(to(what), { method: 'POST', body });
    if (!answer.ok) throw new Error(`${what}: ${answer.status}`);
  };
  try {
    const answer = await fetch(to('dance'));
    for await (const picture of pictures((await answer.json()) as DanceJson, asked))
      await send('picture', picture);
  } catch (error) {
    await send('failure', error instanceof Error ? error.message : String(error));
  }
}

/** The pictures of a dance as PNG. */
async function* pictures(json: DanceJson, asked: URLSearchParams): AsyncGenerator<Blob> {
  const number = (name: string) => Number(asked.get(name) ?? 0);
  const [width, height, start] = [number('width'), number('height'), number('start')];
  const [fps, frames] = [number('fps'), number('frames')];
  const theme: Look = asked.get('theme') === 'dark' ? 'dark' : 'light';
  const build = asked.get('figure') === 'broad' ? 'male' : 'female';
  document.body.dataset.mode = 'film';
  const stage = new Stage(byId<HTMLCanvasElement>('stage'), { width, height });
  stage.paint(theme);
  const dance = Dance.of(json);
  const figure = new Mannequin(dance.skeleton, build, 'fine', SKIN, ACCENTS[0]);
  const pose = emptyPose(dance.skeleton.joints.length);
  const sheet = new OffscreenCanvas(width, height);
  const context = sheet.getContext('2d');
  if (!context) throw new Error('the browser draws no pictures');
  const behind = context.createRadialGradient(
    ...([width / 2, height * 0.42, 0] as const),
    ...([width / 2, height * 0.42, Math.max(width, height) * 0.62] as const),
  );
  BACKGROUNDS[theme].forEach((colour, i) => behind.addColorStop(i, colour));
  const show = (frame: number) => {
    dance.sample(start + frame / fps, false, pose);
    figure.pose(pose);
  };
  show(0);
  stage.add(figure);
  const view = VIEWS[asked.get('look') ?? ''];
  if (view) stage.view.look(...view);
  if (asked.get('camera') === 'fixed') {
    stage.view.track(middle(dance, start, frames / fps), 1e3);
    stage.view.follow = false;
  }
  for (let frame = 0; frame < frames; frame++) {
    show(frame);
    // The camera begins where the dancer is.
    const drawn = stage.shoot(frame === 0 ? 1e3 : 1 / fps);
    context.fillStyle = behind;
    context.fillRect(0, 0, width, height);
    context.drawImage(drawn, 0, 0, width, height);
    yield await sheet.convertToBlob({ type: 'image/png' });
  }
}

/** The middle of a dancer's way. */
function middle(dance: Dance, start: number, seconds: number): Vector3 {
  const pose = emptyPose(dance.skeleton.joints.length);
  const sum = new Vector3();
  const steps = 32;
  for (let step = 0; step < steps; step++) {
    dance.sample(start + ((step + 0.5) / steps) * seconds, false, pose);
    sum.add(new Vector3().fromArray(pose.root));
  }
  return sum.divideScalar(steps);
}
