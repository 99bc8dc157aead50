# sqlite3: what is heard goes into a file with the time of the database and of Python, and is read again.
import datetime, os, socket, sqlite3, sys, time
me = int(sys.argv[1]); other = 3 - me
if os.path.exists(f"log{me}.db"): os.remove(f"log{me}.db")
db = sqlite3.connect(f"log{me}.db"); db.execute("create table heard (id integer primary key, text, at datetime default (strftime('%Y-%m-%d %H:%M:%f', 'now')), py real, chance integer default (abs(random()) % 1000))")
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("", 5011)); s.settimeout(2); time.sleep(0.95)
for k in range(3):
    s.sendto(f"{k} of {me}".encode(), (f"10.0.0.{other}", 5011))
    with db: db.execute("insert into heard (text, py) values (?, ?)", (s.recv(100).decode(), time.time()))
    time.sleep(1)
rows = db.execute("select text, at, py, chance from heard order by id").fetchall()
first = rows[0][2]
for text, at, py, chance in rows:
    same = abs(datetime.datetime.fromisoformat(at + "+00:00").timestamp() - py) < 0.05
    print(f"{py - first:.1f} {text}, clocks agree: {same}, chance {chance}")
print(datetime.datetime.fromtimestamp(os.stat(f"log{me}.db").st_mtime).year == datetime.datetime.now().year)
