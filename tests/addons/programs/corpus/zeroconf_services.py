# zeroconf: three agents announce a service by multicast DNS, browse, and ask for the addresses.
import socket, sys, time
from zeroconf import ServiceBrowser, ServiceInfo, Zeroconf
me = int(sys.argv[1]); kind = "_auv._udp.local."; found = []

class Listener:
    def add_service(self, zc, kind, name):
        info = zc.get_service_info(kind, name, 2000)
        found.append((name.split(".")[0], info and info.parsed_addresses(), info and info.properties.get(b"depth")))
    def remove_service(self, zc, kind, name): print("removed", name.split(".")[0])
    update_service = lambda self, *a: None

z = Zeroconf(interfaces=[f"10.0.0.{me}"])
z.register_service(ServiceInfo(kind, f"auv{me}.{kind}", addresses=[socket.inet_aton(f"10.0.0.{me}")], port=9000, properties={"depth": str(10 * me)}, server=f"auv{me}.local."))
ServiceBrowser(z, kind, Listener()); time.sleep(4.5)
print(*sorted(found), sep="\n")
z.close(); print("done")
