"""Settings for all tests: properties are the same examples in every run, and no deadline judges a busy machine."""

import signal
import threading

from hypothesis import settings

settings.register_profile("rm501", deadline=None, derandomize=True)
settings.load_profile("rm501")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    # a shell starts what runs in the background with interrupts ignored, and every child inherits that
    signal.signal(signal.SIGINT, signal.default_int_handler)
