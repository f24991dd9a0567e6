"""What importing VOSK does not bring along."""

from __future__ import annotations

import json
import subprocess
import sys

PROGRAM = """
import json, sys
import modalities.voice.decoder
loaded = [name for name in ("requests", "urllib3", "srt", "tqdm") if name in sys.modules]
import requests, tqdm
print(json.dumps([loaded, callable(requests.get), callable(tqdm.tqdm)]))
"""


def test_speech_loads_no_web_client_and_others_get_the_real_one() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [[], True, True]
