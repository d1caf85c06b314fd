"""Someone at Foxglove's protocol who waits for a message of each topic, and tells them as JSON: PORT TOPIC ..."""

import json
import sys

from websockets.sync.client import connect


def main():
    wanted, told, names = set(sys.argv[2:]), {}, {}
    with connect(f"ws://127.0.0.1:{sys.argv[1]}", subprotocols=["foxglove.sdk.v1"]) as server:
        while wanted - set(told):
            came = server.recv(timeout=300.0)
            if isinstance(came, bytes):
                if came[0] == 1:  # data of a message: id (4 bytes), time (8 bytes)
                    told[names[int.from_bytes(came[1:5], "little")]] = json.loads(came[13:])
            elif (heard := json.loads(came)).get("op") == "advertise":
                names |= {one["id"]: one["topic"] for one in heard["channels"]}
                asked = [{"id": one["id"], "channelId": one["id"]} for one in heard["channels"]]
                server.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
    print(json.dumps(told))


if __name__ == "__main__":
    main()
