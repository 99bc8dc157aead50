# flask with its threading server in agent 1, http.client in agent 2 on one kept connection.
import http.client, json, sys, threading, time
me = int(sys.argv[1])
if me == 1:
    import flask, logging
    from werkzeug.serving import make_server
    logging.getLogger("werkzeug").disabled = True
    app = flask.Flask("fleet"); seen = []
    @app.post("/report")
    def report(): seen.append(flask.request.json["k"]); return flask.jsonify(seen=seen)
    server = make_server("10.0.0.1", 8083, app, threaded=True); threading.Timer(6, server.shutdown).start(); server.serve_forever(); print("stopped", seen)
else:
    time.sleep(2)
    for k in range(3):
        c = http.client.HTTPConnection("10.0.0.1", 8083, timeout=2); c.request("POST", "/report", json.dumps({"k": k}), {"Content-Type": "application/json"})
        r = c.getresponse(); print(r.status, json.load(r)); time.sleep(0.5)
