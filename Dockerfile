# Three stages: the program, the ONNX Runtime library, and an image with those two, the default
# model and Debian's C++ runtime: no compiler, no Python, no root, no writes.
#
#   docker build -t bailando .
#   docker run --rm -p 8080:8080 --read-only --cap-drop ALL bailando
#
# The variant for NVIDIA GPUs has CUDA and cuDNN beside ONNX Runtime, and computes there:
#
#   docker build --build-arg DEVICE=cuda -t bailando:cuda .
#   docker run --rm --gpus all -p 8080:8080 --read-only --cap-drop ALL bailando:cuda

ARG DEVICE=cpu

FROM rust:1.95-bookworm AS builder
WORKDIR /build
# jemalloc is built for a largest page size, by default that of this machine; arm64 kernels have pages
# of up to 64 KiB.
RUN if [ "$(uname -m)" = aarch64 ]; then \
        printf '[env]\nJEMALLOC_SYS_WITH_LG_PAGE = "16"\n' > "$CARGO_HOME/config.toml"; \
    fi
# Dependencies and crates in a layer of their own: they change less often than the service.
COPY Cargo.toml Cargo.lock ./
COPY .cargo .cargo
COPY crates crates
COPY models/beats models/beats
COPY train/Cargo.toml train/
RUN mkdir -p src train/src train/benches \
    && touch src/lib.rs train/src/lib.rs train/benches/steps.rs \
    && echo 'fn main() {}' > src/main.rs \
    && echo 'fn main() {}' > train/src/main.rs \
    && cargo build --release --locked --package bailando --bin bailando
COPY . .
# cargo compares modification times, and those of the context may be older than the layer above.
RUN touch src/lib.rs src/main.rs \
    && cargo build --release --locked --package bailando --bin bailando \
    # Readable by any user, also from a checkout under a strict umask.
    && chmod --recursive a+rX models LICENSE

FROM debian:bookworm-slim AS onnxruntime
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends ca-certificates python3-pip \
    && rm -rf /var/lib/apt/lists/*
COPY scripts/fetch-onnxruntime.sh /
ARG DEVICE
RUN if [ "$DEVICE" = cuda ]; then set -- --cuda; fi \
    && /fetch-onnxruntime.sh "$@" --dest /opt/onnxruntime \
    # The licences in a folder of their own, whatever their number.
    && mkdir /opt/onnxruntime/doc \
    && find /opt/onnxruntime -mindepth 1 -maxdepth 1 ! -name lib ! -name doc \
        -exec mv --target-directory=/opt/onnxruntime/doc {} +

FROM debian:bookworm-slim
LABEL org.opencontainers.image.title="bailando" \
      org.opencontainers.image.description="Music in, 3-D dance out, over HTTP" \
      org.opencontainers.image.licenses="MIT"
# hadolint ignore=DL3008
RUN apt-get update \
    # cuDNN needs zlib.
    && apt-get install --yes --no-install-recommends ca-certificates libstdc++6 zlib1g \
    && rm -rf /var/lib/apt/lists/*
COPY --from=onnxruntime /opt/onnxruntime/doc /usr/local/share/doc/onnxruntime
COPY --from=onnxruntime /opt/onnxruntime/lib /usr/local/lib
ARG DEVICE
ENV BAILANDO_DEVICE=${DEVICE} \
    ORT_DYLIB_PATH=/usr/local/lib/libonnxruntime.so \
    BAILANDO_HOST=0.0.0.0 \
    BAILANDO_MODEL_DIR=/app/models/default
WORKDIR /app
COPY --from=builder /build/LICENSE ./
COPY --from=builder /build/models/default models/default
COPY --from=builder /build/models/beats/LICENCE.md /build/models/beats/manifest.json models/beats/
COPY --from=builder /build/target/release/bailando /usr/local/bin/
# Jobs, songs and results: whoever runs the image may write there, and nowhere else. Where even that
# is read-only, jobs are kept in memory.
RUN install -d -m 1777 /app/bailando-data
VOLUME /app/bailando-data
# A number, so that an orchestrator can check that it is not root. Any other user will do: everything
# is readable by all.
USER 10001:10001
EXPOSE 8080
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=30s --timeout=5s --start-period=20s --retries=3 \
    CMD ["bailando", "healthcheck"]
ENTRYPOINT ["bailando"]
CMD ["serve"]
