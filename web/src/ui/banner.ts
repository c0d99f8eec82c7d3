import { ServerFault } from '../api/server';
import { byId } from './dom';

/** Says what went wrong, in the server's words where it was the server. */
export class Banner {
  private again: (() => void) | null = null;

  constructor() {
    byId('dismiss').addEventListener('click', () => this.hide());
    byId('retry').addEventListener('click', () => {
      const again = this.again;
      this.hide();
      again?.();
    });
  }

  show(error: unknown, again: (() => void) | null = null): void {
    const fault = error instanceof ServerFault ? error : null;
    byId('banner-text').textContent = error instanceof Error ? error.message : String(error);
    byId('banner-id').textContent = fault?.requestId ? `Request ${fault.requestId}` : '';
    const busy =
      fault !== null && (fault.status === 0 || fault.status === 429 || fault.status >= 500);
    this.again = busy ? again : null;
    byId('retry').hidden = this.again === null;
    byId('banner').hidden = false;
    if (fault?.status === 401) {
      byId('key-field').hidden = false;
      byId('key').focus();
      // On a phone the message would cover it.
      byId('key').scrollIntoView({ block: 'center' });
    }
  }

  hide(): void {
    byId('banner').hidden = true;
    this.again = null;
  }
}
