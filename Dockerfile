# rsb-console beside ROS 2 Jazzy: `docker compose run --rm demo`, or docs/docker.md for a robot.
FROM ros:jazzy-ros-base
# Of ROS's packages only the newest can be had.
# hadolint ignore=DL3008
RUN apt-get update \
  && apt-get install --no-install-recommends -y python3-venv ros-jazzy-common-interfaces \
  && rm -rf /var/lib/apt/lists/* \
  && useradd --create-home --uid 10001 rsb \
  && install -d -m 1777 /home/rsb/.local/state
WORKDIR /opt/rsb-console
COPY . source
# ROS takes numpy and lark from the system.
RUN python3 -m venv --system-site-packages . \
  && bin/pip install --no-cache-dir --require-hashes -r source/locks/fleet.txt \
  && bin/pip install --no-cache-dir --no-deps --no-build-isolation ./source \
  && rm -rf source
ENV PATH=/opt/rsb-console/bin:$PATH LANG=C.UTF-8
USER 10001
WORKDIR /home/rsb
# The image's own entry point sources /opt/ros/jazzy/setup.bash.
ENTRYPOINT ["/ros_entrypoint.sh", "rsb-console"]
CMD ["--help"]
