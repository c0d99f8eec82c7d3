import { canRecord, LONGEST, record, type Recording } from '../audio/recorder';
import demo from '../demo.mp3?url';
import { byId, press } from './dom';

/** What browsers mean by the names of their errors. */
const REFUSALS: Record<string, string> = {
  NotAllowedError: 'The browser does not allow the microphone.',
  NotFoundError: 'There is no microphone.',
  NotReadableError: 'The microphone is in use by another program.',
};

/** Ways to bring a song or a character: choose, drop, record, or take ours. */
export class Intake {
  private recording: Recording | null = null;

  constructor(
    private readonly song: (file: File) => void,
    private readonly character: (file: File) => void,
    private readonly animation: (file: File) => void,
    private readonly failed: (error: unknown) => void,
  ) {
    const file = byId<HTMLInputElement>('file');
    file.addEventListener('change', () => {
      if (file.files?.[0]) this.take(file.files[0]);
      // So that the same file can be chosen again.
      file.value = '';
    });
    for (const id of ['demo', 'hint-demo'])
      byId(id).addEventListener('click', () => void this.demo());
    const button = byId<HTMLButtonElement>('record');
    button.disabled = !canRecord();
    if (!canRecord()) button.title = 'Recording needs a microphone, and HTTPS or localhost';
    button.addEventListener('click', () => void this.record());
    this.drops();
  }

  private take(file: File): void {
    if (/\.vrma$/i.test(file.name)) this.animation(file);
    else if (/\.(vrm|glb|gltf)$/i.test(file.name)) this.character(file);
    else this.song(file);
  }

  private async demo(): Promise<void> {
    try {
      const answer = await fetch(demo);
      if (!answer.ok) throw new Error('The demo song cannot be loaded.');
      this.song(new File([await answer.blob()], 'demo.mp3', { type: 'audio/mpeg' }));
    } catch (error) {
      this.failed(error);
    }
  }

  private async record(): Promise<void> {
    if (this.recording) return this.recording.stop();
    const button = byId('record');
    try {
      this.recording = await record((seconds) => {
        button.textContent = `Stop (${Math.max(Math.ceil(LONGEST - seconds), 0)} s)`;
      });
      press(button, true);
      this.song(await this.recording.song);
    } catch (error) {
      const said = error instanceof DOMException ? REFUSALS[error.name] : undefined;
      this.failed(said ?? error);
    } finally {
      this.recording = null;
      press(button, false);
      button.textContent = 'Record';
    }
  }

  private drops(): void {
    const dragging = (on: boolean) => document.body.classList.toggle('drag', on);
    document.addEventListener('dragover', (event) => {
      event.preventDefault();
      dragging(event.dataTransfer?.types.includes('Files') ?? false);
    });
    document.addEventListener('dragleave', (event) => {
      if (!event.relatedTarget) dragging(false);
    });
    document.addEventListener('drop', (event) => {
      event.preventDefault();
      dragging(false);
      for (const file of event.dataTransfer?.files ?? []) this.take(file);
    });
  }
}
