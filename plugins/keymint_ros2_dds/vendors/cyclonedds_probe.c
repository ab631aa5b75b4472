// SPDX-License-Identifier: Apache-2.0
/* A secure participant of Cyclone DDS 0.10. It reads one command per line from stdin, and answers each with one line on
 * stdout. participants.py, which starts it, describes the protocol. */

#include <pthread.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "dds/dds.h"
#include "dds/ddsrt/log.h"

#define MAX_WORDS 64
#define MAX_EDGES 64
#define LINE_LENGTH 65536

typedef struct {
  char *data;
} Sample;

static const uint32_t sample_ops[] = {DDS_OP_ADR | DDS_OP_TYPE_STR, offsetof(Sample, data), DDS_OP_RTS};
static const dds_topic_descriptor_t sample_descriptor = {
    .m_size = sizeof(Sample),
    .m_align = _Alignof(Sample),
    .m_typename = "std_msgs::msg::dds_::String_",
    .m_nops = 2,
    .m_ops = sample_ops,
    .m_meta = "",
};

typedef struct {
  char name[32];
  dds_entity_t entity;
  bool writes;
} Edge;

static Edge edges[MAX_EDGES];
static size_t edge_count;
static dds_entity_t participant;

static pthread_mutex_t log_lock = PTHREAD_MUTEX_INITIALIZER;
static char last_message[1024];

static void keep_message(void *argument, const dds_log_data_t *data)
{
  (void)argument;
  pthread_mutex_lock(&log_lock);
  snprintf(last_message, sizeof last_message, "%s", data->message);
  last_message[strcspn(last_message, "\r\n")] = '\0';
  pthread_mutex_unlock(&log_lock);
}

static bool take_message(char *message, size_t size)
{
  pthread_mutex_lock(&log_lock);
  snprintf(message, size, "%s", last_message);
  last_message[0] = '\0';
  pthread_mutex_unlock(&log_lock);
  return message[0] != '\0';
}

static void refuse(const char *answer, dds_return_t code)
{
  char message[sizeof last_message];
  take_message(message, sizeof message);
  printf("%s %d %s\n", answer, (int)code, message);
}

static void set_library(dds_qos_t *qos, const char *plugin, const char *library, const char *verb)
{
  char name[128], value[128];
  snprintf(name, sizeof name, "dds.sec.%s.library.path", plugin);
  dds_qset_prop(qos, name, library);
  snprintf(name, sizeof name, "dds.sec.%s.library.init", plugin);
  snprintf(value, sizeof value, "init_%s", verb);
  dds_qset_prop(qos, name, value);
  snprintf(name, sizeof name, "dds.sec.%s.library.finalize", plugin);
  snprintf(value, sizeof value, "finalize_%s", verb);
  dds_qset_prop(qos, name, value);
}

static void set_file(dds_qos_t *qos, const char *property, const char *folder, const char *file)
{
  char value[4096];
  snprintf(value, sizeof value, "file:%s/%s", folder, file);
  dds_qset_prop(qos, property, value);
}

/* The layout of Ardent has one file for both authorities. */
static void set_authority(dds_qos_t *qos, const char *property, const char *folder, const char *file)
{
  char path[4096];
  snprintf(path, sizeof path, "%s/%s", folder, file);
  set_file(qos, property, folder, access(path, F_OK) == 0 ? file : "ca.cert.pem");
}

/* crl is the name of a revocation list in the folder, or empty; access_control is the path of an access-control plugin
 * to use instead of the vendor's. */
static void open_participant(
    uint32_t domain, const char *folder, const char *crl, const char *plugins, const char *access_control)
{
  char library[3][4096];
  const char *names[3] = {"auth", "crypto", "ac"};
  for (size_t i = 0; i < 3; i++)
    snprintf(library[i], sizeof library[i], "%s/libdds_security_%s.so", plugins, names[i]);
  if (access_control)
    snprintf(library[2], sizeof library[2], "%s", access_control);
  dds_qos_t *qos = dds_create_qos();
  set_library(qos, "auth", library[0], "authentication");
  set_library(qos, "crypto", library[1], "crypto");
  set_library(qos, "access", library[2], "access_control");
  set_authority(qos, "dds.sec.auth.identity_ca", folder, "identity_ca.cert.pem");
  set_file(qos, "dds.sec.auth.identity_certificate", folder, "cert.pem");
  set_file(qos, "dds.sec.auth.private_key", folder, "key.pem");
  set_authority(qos, "dds.sec.access.permissions_ca", folder, "permissions_ca.cert.pem");
  set_file(qos, "dds.sec.access.governance", folder, "governance.p7s");
  set_file(qos, "dds.sec.access.permissions", folder, "permissions.p7s");
  if (crl[0])
    set_file(qos, "org.eclipse.cyclonedds.sec.auth.crl", folder, crl);
  participant = dds_create_participant(domain, qos, NULL);
  dds_delete_qos(qos);
  if (participant < 0)
    refuse("REFUSED", participant);
  else
    printf("OPENED\n");
}

/* Create the topic, and a writer or reader of it; if that is denied, delete both and return a negative code. */
static dds_entity_t create_edge(bool writes, const char *topic_name, char **partitions, uint32_t partition_count)
{
  dds_qos_t *qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_durability(qos, DDS_DURABILITY_TRANSIENT_LOCAL);
  dds_qset_history(qos, DDS_HISTORY_KEEP_ALL, 0);
  const dds_entity_t topic = dds_create_topic(participant, &sample_descriptor, topic_name, qos, NULL);
  dds_entity_t edge = topic;
  if (topic >= 0)
  {
    dds_qset_partition(qos, partition_count, (const char **)partitions);
    const dds_entity_t group =
        writes ? dds_create_publisher(participant, qos, NULL) : dds_create_subscriber(participant, qos, NULL);
    edge = writes ? dds_create_writer(group, topic, qos, NULL) : dds_create_reader(group, topic, qos, NULL);
    dds_delete(topic);
    if (edge < 0)
      dds_delete(group);
  }
  dds_delete_qos(qos);
  return edge;
}

static Edge *find_edge(const char *name)
{
  for (size_t i = 0; i < edge_count; i++)
    if (strcmp(edges[i].name, name) == 0)
      return &edges[i];
  return NULL;
}

static uint32_t matched(const Edge *edge)
{
  dds_publication_matched_status_t publication = {0};
  dds_subscription_matched_status_t subscription = {0};
  if (edge->writes)
    dds_get_publication_matched_status(edge->entity, &publication);
  else
    dds_get_subscription_matched_status(edge->entity, &subscription);
  return edge->writes ? publication.current_count : subscription.current_count;
}

static void await_match(const Edge *edge, int milliseconds)
{
  char message[sizeof last_message];
  for (int waited = 0; waited <= milliseconds; waited += 2)
  {
    const uint32_t count = matched(edge);
    if (count > 0)
    {
      printf("MATCHED %u\n", count);
      return;
    }
    if (take_message(message, sizeof message))
    {
      printf("REJECTED %s\n", message);
      return;
    }
    dds_sleepfor(DDS_MSECS(2));
  }
  printf("TIMEOUT\n");
}

static void read_sample(const Edge *edge, int milliseconds)
{
  for (int waited = 0; waited <= milliseconds; waited += 2)
  {
    void *sample = NULL;
    dds_sample_info_t info;
    const dds_return_t count = dds_take(edge->entity, &sample, &info, 1, 1);
    const bool valid = count > 0 && info.valid_data;
    if (valid)
      printf("SAMPLE %s\n", ((const Sample *)sample)->data);
    if (count > 0)
      dds_return_loan(edge->entity, &sample, count);
    if (valid)
      return;
    dds_sleepfor(DDS_MSECS(2));
  }
  printf("TIMEOUT\n");
}

static void edge_command(const char *command, char **words, size_t count)
{
  const bool keeps = strcmp(command, "EDGE") == 0;
  const size_t first = keeps ? 1 : 0;
  if (count < first + 2 || (keeps && edge_count == MAX_EDGES))
  {
    printf("ERROR malformed command\n");
    return;
  }
  const bool writes = strcmp(words[first], "publish") == 0;
  const dds_entity_t entity =
      create_edge(writes, words[first + 1], &words[first + 2], (uint32_t)(count - first - 2));
  if (entity < 0)
  {
    refuse("DENIED", entity);
    return;
  }
  if (keeps)
  {
    Edge *edge = &edges[edge_count++];
    snprintf(edge->name, sizeof edge->name, "%s", words[0]);
    edge->entity = entity;
    edge->writes = writes;
  }
  else
    dds_delete(dds_get_parent(entity));
  printf("ALLOWED\n");
}

static bool obey(char **words, size_t count)
{
  const char *command = words[0];
  const Edge *edge = count > 1 ? find_edge(words[1]) : NULL;
  if (strcmp(command, "OPEN") == 0 && (count == 5 || count == 6))
    open_participant((uint32_t)atoi(words[1]), words[2], words[3], words[4], count == 6 ? words[5] : NULL);
  else if (strcmp(command, "EDGE") == 0 || strcmp(command, "TRY") == 0)
    edge_command(command, words + 1, count - 1);
  else if (strcmp(command, "AWAIT") == 0 && edge && count == 3)
    await_match(edge, atoi(words[2]));
  else if (strcmp(command, "WRITE") == 0 && edge && count == 3)
  {
    const Sample sample = {.data = words[2]};
    const dds_return_t code = dds_write(edge->entity, &sample);
    if (code < 0)
      refuse("ERROR", code);
    else
      printf("WRITTEN\n");
  }
  else if (strcmp(command, "READ") == 0 && edge && count == 3)
    read_sample(edge, atoi(words[2]));
  else if (strcmp(command, "CLOSE") == 0)
  {
    dds_delete(DDS_CYCLONEDDS_HANDLE);
    printf("CLOSED\n");
    return false;
  }
  else
    printf("ERROR malformed command\n");
  return true;
}

int main(void)
{
  static char line[LINE_LENGTH];
  dds_set_log_mask(DDS_LC_FATAL | DDS_LC_ERROR | DDS_LC_WARNING);
  dds_set_log_sink(keep_message, NULL);
  bool more = true;
  while (more && fgets(line, sizeof line, stdin))
  {
    char *words[MAX_WORDS], *rest = line;
    size_t count = 0;
    line[strcspn(line, "\n")] = '\0';
    while (count < MAX_WORDS && rest)
      words[count++] = strsep(&rest, "\t");
    more = obey(words, count);
    fflush(stdout);
  }
  return 0;
}
