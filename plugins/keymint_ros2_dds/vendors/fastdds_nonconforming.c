// SPDX-License-Identifier: Apache-2.0
/* Preloaded into a participant of Fast DDS 2.9 or 3, it makes the participant ignore its own permissions: the local checks
 * of writers and readers always succeed. Peers get its true identity and permissions, and only they can refuse it. These
 * names replace the library's functions, because its table of virtual functions is bound by name. */

#include <stdbool.h>

bool allow(void)
{
  return true;
}

#define ALLOWED(function, library, name)                                                                               \
  bool function(void) __asm__("_ZN8eprosima" library "4rtps8security11Permissions" name                                \
          "ERKNS2_6HandleEjRKNSt7__cxx1112basic_stringIcSt11char_traitsIcESaIcEEERKSt6vectorISC_SaISC_EERNS2_"         \
          "17SecurityExceptionE") __attribute__((alias("allow")))

ALLOWED(has_writer_2, "8fastrtps", "23check_create_datawriter");
ALLOWED(has_reader_2, "8fastrtps", "23check_create_datareader");
ALLOWED(has_writer_3, "7fastdds", "23check_create_datawriter");
ALLOWED(has_reader_3, "7fastdds", "23check_create_datareader");
