# pynng: a surveyor and a publisher in agent 1, respondents and subscribers in agents 2 and 3.
import sys, time, pynng
me = int(sys.argv[1])
if me == 1:
    with pynng.Surveyor0(listen="tcp://10.0.0.1:5040") as survey, pynng.Pub0(listen="tcp://10.0.0.1:5041") as pub:
        time.sleep(2); survey.survey_time = 1000; survey.send(b"well?"); answers = []
        try:
            while True: answers.append(survey.recv())
        except pynng.Timeout: print(sorted(answers))
        for k in range(3): pub.send(b"depth %d" % k); time.sleep(0.5)
else:
    time.sleep(0.5)
    with pynng.Respondent0(dial="tcp://10.0.0.1:5040", recv_timeout=4000) as r, pynng.Sub0(dial="tcp://10.0.0.1:5041", topics=b"depth", recv_timeout=4000) as sub:
        print(r.recv()); r.send(b"agent %d is" % me)
        for k in range(3): print(sub.recv())
print("done")
