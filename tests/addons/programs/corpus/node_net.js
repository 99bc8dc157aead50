// node.js net and http: agent 1 serves lines and pages, agents 2 and 3 ask; a worker thread sums.
const net = require('net'), http = require('http'), { Worker } = require('worker_threads'), me = +process.argv[2];
if (me == 1) {
  const lines = net.createServer(c => { c.on('data', d => setTimeout(() => c.write('echo ' + d), 300)); c.on('error', e => console.log(e.code)); }).listen(5061, '10.0.0.1');
  const pages = http.createServer((q, r) => r.end('page ' + q.url)).listen(5062, '10.0.0.1');
  setTimeout(() => { console.log('stopped'); process.exit(0); }, 6000);
} else {
  setTimeout(() => {
    const c = net.connect(5061, '10.0.0.1', () => c.write(`0 of ${me}`)); let k = 0;
    c.on('data', d => { console.log(d.toString()); if (++k < 3) c.write(`${k} of ${me}`); else c.end(); });
    c.on('close', () => http.get('http://10.0.0.1:5062/depth', r => r.on('data', d => console.log(r.statusCode, d.toString())).on('end', work)));
  }, 1000);
  const work = () => new Worker('let n = 0; for (let i = 0; i < 1e6; i++) n += i; require("worker_threads").parentPort.postMessage(n)', { eval: true })
    .on('message', n => { console.log('sum', n); setTimeout(() => process.exit(0), 500); });
}
