import { App } from './app';
import './style.css';

const app = new App();
// For tests and for pictures made of the page: what plays, and where it is.
Object.assign(window, { bailando: app });
void app.start();
