#!/usr/bin/env python3
"""Serves a clip by RTSP at its own rate, once per client, for `tractrix live rtsp://127.0.0.1:PORT/test`.

    scripts/live/rtsp.py VIDEO PORT [--codec h264|h265] [--transport tcp|udp]

VIDEO is an MP4. Prints "ready" when it listens. Needs Debian's gir1.2-gst-rtsp-server-1.0, python3-gi,
gstreamer1.0-plugins-good and -bad, hence Debian's own Python.
"""

import argparse
from pathlib import Path

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtsp", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtsp, GstRtspServer  # noqa: E402


def main() -> None:
    """Serves until it is stopped."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("video", type=Path)
    parser.add_argument("port")
    parser.add_argument("--codec", choices=("h264", "h265"), default="h264")
    parser.add_argument("--transport", choices=("tcp", "udp"), help="the only one that is offered")
    args = parser.parse_args()
    Gst.init(None)
    server, factory = GstRtspServer.RTSPServer(), GstRtspServer.RTSPMediaFactory()
    server.set_address("127.0.0.1")
    server.set_service(args.port)
    packets = f"qtdemux ! {args.codec}parse ! rtp{args.codec}pay name=pay0 pt=96 config-interval=-1"
    factory.set_launch(f"( filesrc location={args.video} ! {packets} )")
    if args.transport:
        factory.set_protocols(getattr(GstRtsp.RTSPLowerTrans, args.transport.upper()))
    server.get_mount_points().add_factory("/test", factory)
    if not server.attach(None):
        raise SystemExit(f"port {args.port}: cannot listen")
    print("ready", flush=True)
    GLib.MainLoop().run()


if __name__ == "__main__":
    main()
