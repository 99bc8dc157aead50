# aioquic: QUIC with a certificate made at the start; agent 2 opens two streams to agent 1.
import asyncio, datetime, ssl, sys
from aioquic.asyncio import QuicConnectionProtocol, connect, serve
from aioquic.quic.configuration import QuicConfiguration
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
me = int(sys.argv[1])

async def echo(reader, writer): data = await reader.read(); print("asked", data); writer.write(b"echo " + data); writer.write_eof()

async def main():
    if me == 1:
        key = ec.generate_private_key(ec.SECP256R1()); name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "agent1")]); now = datetime.datetime.now(datetime.timezone.utc)
        cert = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key()).serial_number(7).not_valid_before(now - datetime.timedelta(1)).not_valid_after(now + datetime.timedelta(9)).sign(key, hashes.SHA256())
        server = await serve("10.0.0.1", 4433, configuration=QuicConfiguration(is_client=False, certificate=cert, private_key=key), stream_handler=lambda r, w: asyncio.ensure_future(echo(r, w)))
        await asyncio.sleep(6); server.close(); print("stopped"); return
    await asyncio.sleep(1.5)
    async with connect("10.0.0.1", 4433, configuration=QuicConfiguration(verify_mode=ssl.CERT_NONE)) as c:
        for k in range(2):
            reader, writer = await c.create_stream(); writer.write(b"hello %d" % k); writer.write_eof(); print(await reader.read()); await asyncio.sleep(0.5)
        await c.ping(); print("pinged")

asyncio.run(main())
