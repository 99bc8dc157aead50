// node.js dgram: two agents send numbered datagrams, with Date, Math.random and crypto.
const dgram = require('dgram'), crypto = require('crypto'), me = +process.argv[2], start = Date.now();
const s = dgram.createSocket('udp4');
s.on('message', (m, r) => console.log(((Date.now() - start) / 1000).toFixed(1), 'heard', m.toString(), r.address));
s.bind(5060, () => {
  let k = 0;
  setTimeout(() => {
    const timer = setInterval(() => {
      s.send(`${k} of ${me}`, 5060, `10.0.0.${3 - me}`);
      if (++k == 4) { clearInterval(timer); setTimeout(() => { console.log('done'); s.close(); }, 900); }
    }, 1000);
  }, 0);
});
console.log('chance', Math.random(), crypto.randomBytes(4).toString('hex'));
