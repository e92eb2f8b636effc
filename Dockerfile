# Trains and evaluates in a container:
#
#   docker build -t deepbots .
#   docker run --rm -v "$PWD:/work" deepbots train cartpole
#   docker run --rm -v "$PWD:/work" deepbots lint mine.yaml
FROM python:3.11-slim-bookworm

# Where pip finds builds of PyTorch for the CPU, which suffice for small networks: --build-arg TORCH_INDEX=URL.
# Without it, pip installs the build for CUDA, which takes several GB.
ARG TORCH_INDEX=""
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PYTHONUNBUFFERED=1

WORKDIR /deepbots
COPY . .
RUN if [ -n "$TORCH_INDEX" ]; then pip install --index-url "$TORCH_INDEX" torch==2.13.0; fi \
    && pip install ./deepbots_robot ./deepbots_webots "/deepbots[contrib,export,tune,webots]" \
    && mkdir /work \
    && chown 1000:1000 /work

USER 1000:1000
ENV HOME=/work
WORKDIR /work
ENTRYPOINT ["deepbots"]
CMD ["--help"]
