import { Color } from 'three';
import type { Dancer } from './dancer';
import { emptyPose, type Pose, type Skeleton, standingPose } from './motion/skeleton';
import type { BuildName } from './scene/body';
import type { Figure } from './scene/figure';
import { Mannequin } from './scene/mannequin';
import type { Stage } from './scene/stage';
import { SPACING } from './scene/view';

export const SKIN = new Color('#dcd8d0');
/** As `.dot` in the style sheet. */
export const ACCENTS = ['#e2553d', '#1f8f91', '#d99a1c', '#7a5bd0'].map(
  (colour) => new Color(colour),
);

interface Member {
  figure: Figure;
  /** What the figure was made from. */
  source: BuildName | Blob;
  dancer: Dancer | null;
}

/** Puts figures on the stage and moves them. */
export class Cast {
  private members: Member[] = [];
  private source: BuildName | Blob = 'female';
  private pose: Pose = emptyPose(0);
  private generation = 0;

  constructor(private readonly stage: Stage) {}

  /** Shows one figure that stands at ease. */
  async rest(skeleton: Skeleton): Promise<void> {
    await this.show(skeleton, [null]);
  }

  /** Shows these dancers, with the figures that are there as far as they go. */
  async show(skeleton: Skeleton, dancers: (Dancer | null)[]): Promise<void> {
    const generation = ++this.generation;
    const { source } = this;
    const kept = this.members.filter((member) => member.source === source).slice(0, dancers.length);
    const places = dancers.map((_, place) => place).slice(kept.length);
    const made = await Promise.all(places.map((place) => this.figure(skeleton, source, place)));
    if (generation !== this.generation) {
      for (const figure of made) figure.dispose();
      return;
    }
    const gone = this.members.filter((member) => !kept.includes(member));
    this.pose = standingPose(skeleton);
    for (const figure of made) {
      figure.pose(this.pose);
      figure.tick(0);
      this.stage.add(figure);
    }
    // After the new ones were added: what they share stays on the graphics card.
    for (const { figure } of gone) this.stage.remove(figure);
    const figures = [...kept.map(({ figure }) => figure), ...made];
    this.members = figures.map((figure, i) => ({ figure, source, dancer: dancers[i] }));
    this.stage.invalidate();
  }

  /** Chooses the figure: a mannequin of ours, or a character of the user's. */
  async choose(skeleton: Skeleton, source: BuildName | Blob): Promise<void> {
    const before = this.source;
    this.source = source;
    try {
      await this.show(
        skeleton,
        this.members.map(({ dancer }) => dancer),
      );
    } catch (error) {
      this.source = before;
      throw error;
    }
  }

  /** Moves everyone to `time`, `seconds` after the last picture. */
  update(time: number, mirror: boolean, seconds: number): void {
    const middle = (this.members.length - 1) / 2;
    this.members.forEach(({ figure, dancer }, i) => {
      const dance = dancer?.dance;
      const place = (i - middle) * SPACING;
      if (dance && dance.available > 0) {
        dance.sample(time, mirror, this.pose);
        figure.object.position.x = place;
        figure.pose(this.pose);
      } else if (figure.object.position.x !== place) {
        figure.object.position.x = place;
        figure.object.updateMatrixWorld(true);
      }
      figure.tick(seconds);
    });
  }

  private async figure(
    skeleton: Skeleton,
    source: BuildName | Blob,
    place: number,
  ): Promise<Figure> {
    if (typeof source === 'string') {
      const detail = this.stage.software ? 'coarse' : 'fine';
      return new Mannequin(skeleton, source, detail, SKIN, ACCENTS[place % ACCENTS.length]);
    }
    // Loaded on demand: most visitors bring no character.
    const { Avatar } = await import('./scene/avatar');
    return Avatar.read(source, skeleton);
  }
}
