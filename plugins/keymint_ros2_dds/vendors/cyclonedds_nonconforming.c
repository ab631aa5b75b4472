/* An access-control plugin for Cyclone DDS 0.10 whose participant ignores its own permissions: what it checks of itself
 * is always right, all else is done by the vendor's plugin. So peers learn its true identity and permissions, and only
 * they can refuse it. The vendor's plugin is looked for beside the library that is loaded already. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>

#include "dds/security/dds_security_api.h"

struct ddsi_domaingv;
typedef int (*init_function)(const char *, void **, struct ddsi_domaingv *);
typedef int (*finalize_function)(void *);

static void *vendor;

static DDS_Security_boolean joins(dds_security_access_control *plugin, const DDS_Security_PermissionsHandle handle,
                                  const DDS_Security_DomainId domain, const DDS_Security_Qos *qos,
                                  DDS_Security_SecurityException *exception)
{
  (void)plugin, (void)handle, (void)domain, (void)qos, (void)exception;
  return true;
}

static DDS_Security_boolean has_endpoint(dds_security_access_control *plugin,
                                         const DDS_Security_PermissionsHandle handle,
                                         const DDS_Security_DomainId domain, const DDS_Security_char *topic,
                                         const DDS_Security_Qos *qos, const DDS_Security_PartitionQosPolicy *partition,
                                         const DDS_Security_DataTags *tags, DDS_Security_SecurityException *exception)
{
  (void)plugin, (void)handle, (void)domain, (void)topic, (void)qos, (void)partition, (void)tags, (void)exception;
  return true;
}

static DDS_Security_boolean has_topic(dds_security_access_control *plugin, const DDS_Security_PermissionsHandle handle,
                                      const DDS_Security_DomainId domain, const DDS_Security_char *topic,
                                      const DDS_Security_Qos *qos, DDS_Security_SecurityException *exception)
{
  (void)plugin, (void)handle, (void)domain, (void)topic, (void)qos, (void)exception;
  return true;
}

int init_nonconforming(const char *argument, void **context, struct ddsi_domaingv *gv)
{
  vendor = dlopen(KEYMINT_VENDOR_PLUGIN, RTLD_NOW | RTLD_LOCAL);
  if (!vendor)
    return -1;
  const init_function init = (init_function)dlsym(vendor, "init_access_control");
  const int code = init ? init(argument, context, gv) : -1;
  if (code == 0)
  {
    dds_security_access_control *plugin = *context;
    plugin->check_create_participant = joins;
    plugin->check_create_datawriter = has_endpoint;
    plugin->check_create_datareader = has_endpoint;
    plugin->check_create_topic = has_topic;
  }
  return code;
}
