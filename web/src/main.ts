import { App } from './app';
import './style.css';

const asked = new URLSearchParams(location.search);
if (asked.has('film')) {
  // `bailando render` has opened the page.
  void import('./film').then(({ film }) => film(asked));
} else {
  const app = new App();
  // For tests and for pictures made of the page: what plays, and where it is.
  Object.assign(window, { bailando: app });
  void app.start();
}
