"""A reliable subscriber of masks and overlays on Cyclone DDS that a test suspends: prints a line for each mask, so that the test sees
when it receives and when it does not.
"""

import os
import time

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from ros_cyclone_types import LOOPBACK, Image

PERIOD = 0.01  # seconds between two looks


def main():
    number = int(os.environ["ROS_DOMAIN_ID"])
    domain = Domain(number, LOOPBACK)
    participant = DomainParticipant(number)
    reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(5))
    masks = DataReader(participant, Topic(participant, "rt/dynamic_mask", Image), reliable)
    overlays = DataReader(participant, Topic(participant, "rt/overlay", Image), reliable)
    seen = 0
    while True:
        seen += len(overlays.take(N=10))
        for message in masks.take(N=10):
            if seen > 0:
                print("mask", message.header.stamp.sec, message.header.stamp.nanosec, flush=True)
        time.sleep(PERIOD)
    del domain


main()
