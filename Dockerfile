# rsb-console beside ROS 2: `docker compose run --rm demo`, or docs/docker.md for a robot.
# `--build-arg DISTRIBUTION=kilted` takes another base; only that one is fetched. The digests are those of each
# distribution's newest image when they were written here, and Dependabot renews them.
ARG DISTRIBUTION=jazzy
FROM ros:jazzy-ros-base@sha256:386d06ec6d4188f731bae5678e07b4cb64a4e4d4152090c0bd1f881dcf7706f5 AS jazzy
FROM ros:kilted-ros-base@sha256:0fe3d66b179ac21e56f4b88118022e71f9bb167508430fc0036929691f5a2e8f AS kilted
FROM ros:lyrical-ros-base@sha256:dbb2a254523ee3c40ec9fc07956bc1042253c7beb3b6dad4a4585d85c99e9716 AS lyrical
FROM ${DISTRIBUTION}
# Of ROS's packages only the newest can be had.
# hadolint ignore=DL3008
RUN apt-get update \
  && apt-get install --no-install-recommends -y python3-venv "ros-${ROS_DISTRO}-common-interfaces" \
  && rm -rf /var/lib/apt/lists/* \
  && useradd --create-home --uid 10001 rsb \
  && install -d -m 1777 /home/rsb/.local/state \
  && chmod 755 /home/rsb /home/rsb/.local
WORKDIR /opt/rsb-console
COPY . source
# ROS takes numpy and lark from the system.
RUN python3 -m venv --system-site-packages . \
  && bin/pip install --no-cache-dir --require-hashes -r source/locks/fleet.txt \
  && bin/pip install --no-cache-dir --no-deps --no-build-isolation ./source \
  && rm -rf source
# Docker gives another user than the image's (RSB_USER) / as its home, where nothing can be kept.
ENV PATH=/opt/rsb-console/bin:$PATH LANG=C.UTF-8 HOME=/home/rsb
USER 10001
WORKDIR /home/rsb
# The image's own entry point sources the setup file of its ROS.
ENTRYPOINT ["/ros_entrypoint.sh", "rsb-console"]
CMD ["--help"]
