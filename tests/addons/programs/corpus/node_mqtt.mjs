// aedes (npm) is the broker in agent 1, mqtt (npm) the client in agents 2 and 3.
import { createServer } from 'net';
import * as aedes from 'aedes';
import mqtt from 'mqtt';
const me = +process.argv[2];
if (me == 1) {
  const broker = await aedes.Aedes.createBroker();
  createServer(broker.handle).listen(1883, '10.0.0.1');
  setTimeout(() => { console.log('stopped'); process.exit(0); }, 7000);
} else setTimeout(() => {
  const c = mqtt.connect('mqtt://10.0.0.1', { clientId: `agent${me}`, keepalive: 2 }); let k = 0;
  c.on('connect', () => { console.log('connected'); c.subscribe('chat/#', { qos: 1 }); });
  c.on('message', (topic, m) => topic.endsWith(me) || console.log(topic, m.toString()));
  const t = setInterval(() => { c.publish(`chat/${me}`, `${k}`, { qos: 1 }); if (++k == 4) { clearInterval(t); setTimeout(() => c.end(false, () => console.log('done')), 700); } }, 800);
}, 1500);
