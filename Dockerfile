# SPDX-License-Identifier: Apache-2.0
# An image of the command keymint, for a user who is not root; examples/containers shows how to use it.
#   docker build -t keymint .
#   docker run --rm -v "$PWD:/workspace" --user "$(id -u):$(id -g)" keymint provision robot.xml -w robot_ws
FROM python:3.12-slim-bookworm AS build
COPY . /source
RUN /source/.ci/image /opt/keymint

FROM python:3.12-slim-bookworm
COPY --from=build /opt/keymint /opt/keymint
# Volumes that are mounted here for the first time belong to this user.
RUN useradd --uid 1000 --create-home keymint && install -d -o keymint -g keymint -m 0700 /workspace /bundles /keystore
USER keymint
WORKDIR /workspace
ENV PATH=/opt/keymint/bin:$PATH
ENTRYPOINT ["keymint"]
