# The command line in a container: docker build -t fieldgrid . && docker run -v "$PWD:/data" fieldgrid --help
# It needs nothing beyond a base image and the package registries.
FROM python:3.11-slim
WORKDIR /opt/fieldgrid
COPY requirements.lock pyproject.toml README.md LICENSE ./
RUN pip install --no-cache-dir --require-hashes -r requirements.lock
COPY src src
RUN pip install --no-cache-dir --no-deps --no-build-isolation .
RUN useradd --create-home --home-dir /var/lib/field field
USER field
# The compiled kernels are kept here; mount a volume to keep them between runs.
ENV NUMBA_CACHE_DIR=/var/lib/field/.cache/numba
WORKDIR /data
ENTRYPOINT ["fieldgrid"]
