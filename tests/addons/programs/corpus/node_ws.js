// ws (npm): a websocket server in agent 1, clients with pings in agents 2 and 3.
const WebSocket = require('ws'), me = +process.argv[2];
if (me == 1) {
  const server = new WebSocket.Server({ host: '10.0.0.1', port: 5063 });
  server.on('connection', c => c.on('message', m => server.clients.forEach(x => x !== c && x.send(m.toString()))));
  setTimeout(() => { console.log('stopped'); process.exit(0); }, 6500);
} else setTimeout(() => {
  const c = new WebSocket('ws://10.0.0.1:5063'); let k = 0;
  c.on('open', () => { c.ping(); const t = setInterval(() => { c.send(`${k} of ${me}`); if (++k == 3) { clearInterval(t); setTimeout(() => c.close(), 900); } }, 800); });
  c.on('pong', () => console.log('pong')); c.on('message', m => console.log('heard', m.toString())); c.on('close', code => console.log('closed', code));
}, 1500);
