# grpcio without protobuf: a generic handler in agent 1 (unary and stream of strings), a channel in agent 2.
import sys, time, grpc
from concurrent import futures
me = int(sys.argv[1])

def count(request, context):
    for k in range(int(request)): time.sleep(0.3); yield b"%d" % k
def reverse(request, context): return request[::-1]

if me == 1:
    server = grpc.server(futures.ThreadPoolExecutor(4))
    server.add_generic_rpc_handlers([grpc.method_handlers_generic_handler("Fleet", {"Count": grpc.unary_stream_rpc_method_handler(count), "Reverse": grpc.unary_unary_rpc_method_handler(reverse)})])
    server.add_insecure_port("10.0.0.1:50051"); server.start(); time.sleep(6); server.stop(0.5).wait(); print("stopped")
else:
    time.sleep(1.5)
    with grpc.insecure_channel("10.0.0.1:50051") as channel:
        print(channel.unary_unary("/Fleet/Reverse")(b"hello", timeout=3))
        print([x for x in channel.unary_stream("/Fleet/Count")(b"4", timeout=3)])
        try: list(channel.unary_stream("/Fleet/Count")(b"9", timeout=1))
        except grpc.RpcError as e: print(e.code())
